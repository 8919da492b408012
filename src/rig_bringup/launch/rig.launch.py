"""`ros2 launch rig_bringup rig.launch.py [scenario:=NAME] [namespace:=rig] [bag:=DIR]`: the graph of one trial.

The same processes, names and parameters as `ros2_ws/scripts/start_graph.sh` starts.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

NODES = (
    ("user_sim_node", "user_sim_node", "user_sim"),
    ("mig_filter_node", "mig_filter_node", "mig_filter"),
    ("admittance_sim_node", "admittance_sim_node", "admittance_sim"),
    ("task_sim_node", "task_sim_node", "task_sim"),
)


def _scenario(given: str) -> str:
    if Path(given).is_file():
        return given
    shipped = Path(get_package_share_directory("rig_bringup")) / "config" / f"{given.removesuffix('.yaml')}.yaml"
    if not shipped.is_file():
        names = ", ".join(sorted(path.stem for path in shipped.parent.glob("*.yaml")))
        raise RuntimeError(f"scenario {given}: no such file, and none of the shipped ones: {names}")
    return str(shipped)


def _graph(context: LaunchContext) -> list[Node]:
    scenario = _scenario(LaunchConfiguration("scenario").perform(context))
    namespace = LaunchConfiguration("namespace").perform(context)
    bag = LaunchConfiguration("bag").perform(context)
    recorded = [("rig_bag", "recorder", "recorder")] if bag else []
    required = [name for _, _, name in (*NODES[:3], *recorded)]
    own = {"task_sim": {"required_nodes": required}, "recorder": {"uri": bag}}
    return [
        Node(
            package=package,
            executable=executable,
            name=name,
            namespace=namespace,
            parameters=[scenario, *([own[name]] if name in own else [])],
            output="screen",
        )
        for package, executable, name in (*NODES, *recorded)
    ]


def generate_launch_description() -> LaunchDescription:
    """The graph, from launch arguments."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "scenario", default_value="cart_pendulum_noise_assistance", description="name or path of a scenario"
            ),
            DeclareLaunchArgument("namespace", default_value="rig", description="stands in front of every topic"),
            DeclareLaunchArgument("bag", default_value="", description="directory of the bag; empty: do not record"),
            OpaqueFunction(function=_graph),
        ]
    )

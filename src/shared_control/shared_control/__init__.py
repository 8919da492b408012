"""The science of the shared-control rig, with no ROS in it.

Tasks, their integration, the mode insertion gradient (MIG), the filter, controllers, simulated users, the admittance
robot, trials and measures. Nothing is imported here: a process pays only for what it uses (a simulated user and a robot
need numpy, not a compiler).
"""

__version__ = "0.1.0"

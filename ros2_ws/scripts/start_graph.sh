#!/usr/bin/env bash
# Start the graph of one trial, one process a node, and stop all of it when one ends or on SIGINT or SIGTERM.
#
#   usage: start_graph.sh SCENARIO.yaml [MORE_PARAMETERS.yaml ...]
#
# Scenario files are ordinary ROS parameter files. RIG_NAMESPACE (default: rig) stands in front of every topic. With a
# `recorder` section that names a bag (`uri`), the trial is recorded; leave the recorder out with RIG_RECORD=0.
# RIG_USER=display puts a person at the browser page in the place of the simulated user (`./rig up --display` writes the
# parameters for it); a fault then stays until somebody clears it, unless a file says `recovery: automatic`.
set -u

[ $# -ge 1 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }

ros_arguments=(--ros-args -r "__ns:=/${RIG_NAMESPACE:-rig}")
[ "${RIG_USER:-}" != display ] || ros_arguments+=(-p recovery:=explicit)
for file in "$@"; do
    [ -r "$file" ] || { echo "error: cannot read parameter file $file" >&2; exit 2; }
    ros_arguments+=(--params-file "$file")
done

# Job control gives each node a process group of its own, so that a signal reaches `ros2 run` and the node behind it.
set -m
pids=()
start() {
    ros2 run "$1" "$2" "${ros_arguments[@]}" &
    pids+=($!)
}

# The pacemaker ends first, while the recorder still listens: the bag holds how the trial ended.
stop() {
    trap '' INT TERM
    kill -INT -- "-${pids[0]}" 2>/dev/null && wait "${pids[0]}"
    for pid in "${pids[@]}"; do kill -INT -- "-$pid" 2>/dev/null; done
    wait
}
trap 'stop; exit 0' INT TERM

start task_sim_node task_sim_node
start mig_filter_node mig_filter_node
if [ "${RIG_USER:-}" = display ]; then start rig_display display; else start user_sim_node user_sim_node; fi
start admittance_sim_node admittance_sim_node
[ "${RIG_RECORD:-1}" = 0 ] || start rig_bag recorder

wait -n
code=$?
stop
exit "$code"

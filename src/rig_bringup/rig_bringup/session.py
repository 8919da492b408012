"""`./rig study`: with what the study's package cannot have, the graph on which a session runs."""

from __future__ import annotations

import argparse
import os
import queue
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from rig_bringup import scenario
from rig_bringup.graph_process import GraphProcess
from rig_bringup.interrupts import Interrupts
from rig_bringup.up import Line, graph_command, scheduling
from rig_study import study_cli
from rig_study.protocol import Protocol, load_protocol
from rig_study.session import Session

_READY_LIMIT = 60.0  # [s]
_NODES = ("mig_filter", "admittance_sim", "recorder")


def main(argv: Sequence[str]) -> int:
    """As `rig_study.study_cli.main`, with sessions."""
    return study_cli.main(argv, conduct)


def conduct(options: argparse.Namespace) -> int:
    """Run a subject's session; 0 if it came to its end, 130 if it was left before, 1 if the graph failed."""
    scenario.use_shipped_scenarios()
    protocol = load_protocol(options.protocol)
    folder = (study_cli.sessions(options, protocol) / options.subject).resolve()
    with ExitStack() as stack:
        session = stack.enter_context(Session(protocol, options.subject, folder))
        files = _write_parameters(options, protocol, folder)
        print(f"{protocol.name}, {options.subject}, in {folder}", flush=True)
        if options.display:
            print(f"driver    http://127.0.0.1:{options.port}/\noperator  http://127.0.0.1:{options.port}/operator")
        environment = {"RIG_NAMESPACE": options.namespace, **scheduling(options.pacing)}
        environment |= {"RIG_USER": "display"} if options.display else {}
        command = graph_command(options.compose, files, options.namespace)
        try:
            graph = stack.enter_context(GraphProcess(command, folder / "graph.log", environment))
            code = _lead(session, graph, options)
        except KeyboardInterrupt:
            print("\nthe session stops here; the same command goes on with this trial", file=sys.stderr)
            return 130
    if code == 0:
        print(f"{options.subject} has done all trials\nnext: ./rig analyze {folder} --out {folder / 'report'}")
    return code


def _write_parameters(options: argparse.Namespace, protocol: Protocol, folder: Path) -> list[Path]:
    overrides = {"pacing": options.pacing, "duration": protocol.study.duration}
    checked = scenario.load(protocol.study.scenario, overrides, person=options.display)
    if checked.display is not None:
        # The conductor alone starts trials.
        checked.display.update(port=options.port, driver_starts=False)
    run = {
        "/**/task_sim": {
            "scenario": checked.scenario.name,
            "configuration_hash": checked.digest(),
            "required_nodes": ["display" if options.display else "user_sim", *_NODES],
            "autostart": False,
            # With a person, a trial waits until somebody drives.
            "ready_timeout": 0.0 if options.display else _READY_LIMIT,
        },
        "/**/recorder": {
            "uri": str(folder / "bags"),
            "split": "trial",
            "attachments": [str(folder / "scenario.yaml"), str(folder / "protocol.yaml")],
        },
    }
    (folder / "protocol.yaml").write_text(protocol.file.text, encoding="utf-8")
    (folder / "scenario.yaml").write_text(checked.text())
    (folder / "run.yaml").write_text(scenario.parameter_file(run))
    return [folder / "scenario.yaml", folder / "run.yaml"]


def _lead(session: Session, graph: GraphProcess, options: argparse.Namespace) -> int:
    # Imported while the nodes start: it takes about as long as they do.
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from std_srvs.srv import Trigger

    from mig_interfaces.srv import AbortTrial
    from rig_runtime import topics
    from rig_runtime.run import make_executor
    from rig_study.conductor import ConductorNode

    keys = _keys()
    line = Line()
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = ConductorNode(session, wait_for_person=options.display, namespace=options.namespace, context=context)
    executor = make_executor(context)
    executor.add_node(node)
    abort = node.create_client(AbortTrial, topics.ABORT_SERVICE)
    calls = {
        key: (node.create_client(Trigger, name), Trigger.Request())
        for key, name in (("p", topics.PAUSE_SERVICE), ("", topics.RESUME_SERVICE), ("r", topics.REPEAT_SERVICE))
    } | {"a": (abort, AbortTrial.Request(reason="aborted by the operator"))}
    try:
        with Interrupts() as interrupts:
            while not node.over:
                interrupts.check()
                if graph.exit_code is not None:
                    print(f"error: the graph ended before the session did:\n{graph.last_words()}", file=sys.stderr)
                    return 1
                executor.spin_once(timeout_sec=0.1)
                line.show(node.progress())
                while not keys.empty():
                    client, request = calls.get(keys.get(), (None, None))
                    if client is not None and client.service_is_ready():
                        client.call_async(request)
        line.show(node.progress(), last=True)
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
    return 0


def _keys() -> queue.SimpleQueue[str]:
    """What is typed, line by line, where somebody can type."""
    typed: queue.SimpleQueue[str] = queue.SimpleQueue()
    if os.isatty(0):
        threading.Thread(target=lambda: [typed.put(text.strip()) for text in sys.stdin], daemon=True).start()
    return typed

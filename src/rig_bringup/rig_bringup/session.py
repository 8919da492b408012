"""`./rig study`: with what the study's package cannot have, the graph on which a session runs."""

from __future__ import annotations

import argparse
import os
import queue
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from rig_bringup import scenario
from rig_bringup.graph_process import GraphProcess
from rig_bringup.interrupts import Interrupts
from rig_bringup.up import Line, check_free, graph_command, scheduling
from rig_study import study_cli
from rig_study.cohort import load_cohort
from rig_study.declared import StudyError
from rig_study.protocol import PlannedTrial, Protocol, load_protocol
from rig_study.session import Session
from shared_control import scenario as science
from shared_control.users import UserConfig

_READY_LIMIT = 60.0  # [s]
_ENDING_LIMIT = 20.0  # [s]
_NODES = ("mig_filter", "admittance_sim", "recorder")


def main(argv: Sequence[str]) -> int:
    """As `rig_study.study_cli.main`, with sessions."""
    return study_cli.main(argv, conduct)


def conduct(options: argparse.Namespace) -> int:
    """`study run`, or `study simulate --graph`: a subject's session, or that of every virtual subject.

    Returns 0 if it came to its end, 130 if it was left before, 1 if the graph failed.
    """
    scenario.use_shipped_scenarios()
    protocol = load_protocol(options.protocol)
    folder = study_cli.sessions(options, protocol).resolve()
    if options.command == "run":
        port = options.port if options.display else None
        setting = _Setting(options.pacing, options.compose, options.namespace, port)
        code = _session(protocol, options.subject, folder / options.subject, setting)
        if code == 0:
            out = folder / options.subject
            print(f"{options.subject} has done all trials\nnext: ./rig analyze {out} --out {out / 'report'}")
        return code
    if options.workers is not None or options.scheduler is not None:
        raise StudyError("--graph runs one trial after the other; leave out --workers and --scheduler")
    cohort = load_cohort(options.cohort)
    for number, subject in enumerate(protocol.subjects, 1):
        print(f"[{number}/{len(protocol.subjects)}]", end=" ")
        setting = _Setting("lockstep", compose=True, user=cohort.users(protocol, subject))
        code = _session(protocol, subject, folder / subject, setting)
        if code != 0:
            return code
    print(f"all subjects have done all trials\nnext: ./rig analyze {folder} --out {folder / 'report'}")
    return 0


@dataclass(frozen=True)
class _Setting:
    """How a session runs: who pushes, and on which graph."""

    pacing: str
    compose: bool
    namespace: str = "rig"
    #: Of the page at which a person pushes.
    port: int | None = None
    #: The virtual subject, trial by trial; none: the scenario's own user, if it is not a person.
    user: Callable[[PlannedTrial], UserConfig] | None = None


def _session(protocol: Protocol, subject: str, folder: Path, setting: _Setting) -> int:
    with ExitStack() as stack:
        session = stack.enter_context(Session(protocol, subject, folder))
        print(f"{protocol.name}, {subject}, in {folder}", flush=True)
        if session.progress.next() is None:
            return 0
        # The graph of a conductor that was killed takes a moment to end.
        check_free(setting.namespace, _ENDING_LIMIT)
        files = _write_parameters(setting, protocol, subject, folder)
        if setting.port is not None:
            print(f"driver    http://127.0.0.1:{setting.port}/\noperator  http://127.0.0.1:{setting.port}/operator")
        environment = {"RIG_NAMESPACE": setting.namespace, **scheduling(setting.pacing)}
        environment |= {"RIG_USER": "display"} if setting.port is not None else {}
        command = graph_command(setting.compose, files, setting.namespace)
        try:
            graph = stack.enter_context(GraphProcess(command, folder / "graph.log", environment))
            return _lead(session, graph, setting)
        except KeyboardInterrupt:
            print("\nthe session stops here; the same command goes on with this trial", file=sys.stderr)
            return 130


def _write_parameters(setting: _Setting, protocol: Protocol, subject: str, folder: Path) -> list[Path]:
    overrides = {"pacing": setting.pacing, "duration": protocol.study.duration}
    person = setting.port is not None
    checked = scenario.load(protocol.study.scenario, overrides, person=person)
    if checked.display is not None:
        # The conductor alone starts trials.
        checked.display.update(port=setting.port, driver_starts=False)
    if setting.user is not None:
        # Of the trials that follow only the skill is another one.
        user = setting.user(protocol.plan(subject)[0])
        checked = replace(checked, scenario=replace(checked.scenario, user=user))
        science.check(checked.scenario)
    run = {
        "/**/task_sim": {
            "scenario": checked.scenario.name,
            "configuration_hash": checked.digest(),
            "required_nodes": ["display" if person else "user_sim", *_NODES],
            "autostart": False,
            # With a person, a trial waits until somebody drives.
            "ready_timeout": 0.0 if person else _READY_LIMIT,
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


def _lead(session: Session, graph: GraphProcess, setting: _Setting) -> int:
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
    user = setting.user
    node = ConductorNode(
        session,
        wait_for_person=setting.port is not None,
        skill=(lambda trial: user(trial).skill) if user is not None else None,
        namespace=setting.namespace,
        context=context,
    )
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

"""`./rig study`: with what the study's package cannot have, the graph on which a session runs."""

from __future__ import annotations

import argparse
import os
import queue
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix

from rig_bringup import scenario
from rig_bringup.graph_process import GraphProcess
from rig_bringup.interrupts import Interrupts
from rig_bringup.up import Line, check_free, graph_command, invitation, placed, scheduling
from rig_display.parameters import DisplayConfig
from rig_study import study_cli
from rig_study.cohort import load_cohort
from rig_study.declared import StudyError
from rig_study.protocol import PlannedTrial, Protocol, load_protocol
from rig_study.session import Session
from rig_study.studies import Choice, Studies
from shared_control import scenario as science
from shared_control.parameters import ParameterError
from shared_control.users import UserConfig

_READY_LIMIT = 60.0  # [s]
_ENDING_LIMIT = 20.0  # [s]
_FAREWELL = 0.3  # [s]
_NODES = ("mig_filter", "admittance_sim", "recorder")
_LOG = "graph.log"


def main(argv: Sequence[str]) -> int:
    """As `rig_study.study_cli.main`, with sessions."""
    return study_cli.main(argv, conduct)


def conduct(options: argparse.Namespace) -> int:
    """`study run`, or `study simulate --graph`: a subject's session, or that of every virtual subject.

    Returns 0 if it came to its end, 130 if it was left before, 1 if the graph failed.
    """
    scenario.use_shipped_scenarios()
    if options.command == "run":
        return _run(options)
    protocol = load_protocol(options.protocol)
    folder = study_cli.sessions(options, protocol).resolve()
    if options.workers is not None or options.scheduler is not None:
        raise StudyError("--graph runs one trial after the other; leave out --workers and --scheduler")
    cohort = load_cohort(options.cohort)
    for number, subject in enumerate(protocol.subjects, 1):
        print(f"[{number}/{len(protocol.subjects)}]", end=" ")
        setting = _Setting("lockstep", compose=True, user=cohort.users(protocol, subject))
        code, _ = _session(Choice(protocol, subject, folder / subject), setting)
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
    #: --host, --port and --token of the page at which a person pushes.
    page: argparse.Namespace | None = None
    #: The virtual subject, trial by trial; none: the scenario's own user, if it is not a person.
    user: Callable[[PlannedTrial], UserConfig] | None = None
    #: What the operator may choose from on the page; none: there is nothing to choose.
    studies: Studies | None = None

    def invitation(self) -> str:
        """Where the pages are."""
        return "" if self.page is None else invitation(vars(self.page), self.page)

    def display(self, values: dict[str, Any]) -> dict[str, Any]:
        """The display's parameters: the conductor alone starts trials."""
        return {**placed(values, self.page), "driver_starts": False} if self.page is not None else values

    @property
    def environment(self) -> dict[str, str]:
        """Of the nodes, with a person; the token is not in their files, which are kept."""
        return {} if self.page is None else {"RIG_USER": "display", "RIG_DISPLAY_TOKEN": self.page.token or ""}


def _run(options: argparse.Namespace) -> int:
    if options.display and options.pacing != "realtime":
        raise StudyError("--display: a person cannot be hurried, so pacing must be realtime, not lockstep")
    if not options.display and any(value is not None for value in (options.port, options.host, options.token)):
        raise StudyError("--port, --host and --token are for --display; add it")
    setting = _Setting(options.pacing, options.compose, options.namespace)
    if options.display:
        # The same for every session, whatever its scenario says: the pages come back to where they were.
        display = placed(asdict(DisplayConfig()), options)
        options.host, options.port = display["host"], display["port"]
        setting = replace(setting, page=options)
    if options.subject is None:
        return _receive(replace(setting, studies=study_cli.studies(options)))
    if options.protocol is None or options.protocols is not None:
        raise StudyError("--subject: is of one protocol; name that, without --protocols, as in: demo --subject S07")
    protocol = load_protocol(options.protocol)
    folder = study_cli.sessions(options, protocol).resolve() / options.subject
    code, _ = _session(Choice(protocol, options.subject, folder), setting)
    if code == 0:
        print(f"{options.subject} has done all trials\nnext: ./rig analyze {folder} --out {folder / 'report'}")
    return code


def _receive(setting: _Setting) -> int:
    """One session after the other, as the operator chooses on the page, until interrupted."""
    print(f"{setting.invitation()}\nThe operator chooses whose session is led; Ctrl-C ends this.", flush=True)
    choice: Choice | None = None
    said = ""
    while True:
        if choice is None:
            code, choice = _wait_for_choice(setting, said)
            if choice is None:
                return code
        last, said = choice, ""
        try:
            code, choice = _session(last, setting)
        except ParameterError as error:
            choice, said = None, str(error)
            print(f"error: {said}", file=sys.stderr)
            continue
        if code == 130:
            return code
        if code != 0:
            said = f"the graph of {last} has failed; its output is in {last.folder / _LOG}"


def _wait_for_choice(setting: _Setting, said: str) -> tuple[int, Choice | None]:
    """With the pages alone, before a session and after one that failed; `said` tells of that."""
    assert setting.studies is not None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # The task is only looked at.
        page = setting.display(asdict(DisplayConfig()))
        (folder / "display.yaml").write_text(scenario.parameter_file({"/**/display": page}))
        executable = Path(get_package_prefix("rig_display")) / "lib" / "rig_display" / "display"
        arguments = ["--ros-args", "-r", f"__ns:=/{setting.namespace}", "--params-file", str(folder / "display.yaml")]
        with GraphProcess([str(executable), *arguments], folder / _LOG, setting.environment) as pages:
            from rclpy import create_node

            from rig_study.reception import Reception

            with _served(lambda **context: create_node("conductor", namespace=setting.namespace, **context)) as served:
                node, executor = served
                reception = Reception(node, setting.studies, said=said)
                if not _serve(executor, pages, lambda: reception.choice is not None, lambda: "waiting for a choice"):
                    print(f"error: the pages ended:\n{pages.last_words()}", file=sys.stderr)
                    return 1, None
                _linger(executor)
    return 0, reception.choice


def _session(choice: Choice, setting: _Setting) -> tuple[int, Choice | None]:
    """Lead a session; how it ended, and which one was chosen in its place if one was."""
    protocol, subject, folder = choice.protocol, choice.subject, choice.folder
    with ExitStack() as stack:
        session = stack.enter_context(Session(protocol, subject, folder))
        print(f"{protocol.name}, {subject}, in {folder}", flush=True)
        if session.progress.next() is None:
            return 0, None
        # The graph of a conductor that was killed takes a moment to end.
        check_free(setting.namespace, _ENDING_LIMIT)
        files = _write_parameters(setting, protocol, subject, folder)
        if setting.page is not None and setting.studies is None:
            print(setting.invitation())
        environment = {"RIG_NAMESPACE": setting.namespace, **scheduling(setting.pacing), **setting.environment}
        command = graph_command(setting.compose, files, setting.namespace)
        try:
            graph = stack.enter_context(GraphProcess(command, folder / _LOG, environment))
            return _lead(session, graph, setting)
        except KeyboardInterrupt:
            again = "the same command" if setting.studies is None else f"{choice}, chosen again,"
            print(f"\nthe session stops here; {again} goes on with this trial", file=sys.stderr)
            return 130, None


def _write_parameters(setting: _Setting, protocol: Protocol, subject: str, folder: Path) -> list[Path]:
    overrides = {"pacing": setting.pacing, "duration": protocol.study.duration}
    person = setting.page is not None
    checked = scenario.load(protocol.study.scenario, overrides, person=person)
    if checked.display is not None:
        checked = replace(checked, display=setting.display(checked.display))
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


def _lead(session: Session, graph: GraphProcess, setting: _Setting) -> tuple[int, Choice | None]:
    # Imported while the nodes start: it takes about as long as they do.
    from std_srvs.srv import Trigger

    from mig_interfaces.srv import AbortTrial
    from rig_runtime import topics
    from rig_study.conductor import ConductorNode

    keys = _keys()
    user = setting.user

    def make(**context: Any) -> ConductorNode:
        return ConductorNode(
            session,
            wait_for_person=setting.page is not None,
            skill=(lambda trial: user(trial).skill) if user is not None else None,
            studies=setting.studies,
            namespace=setting.namespace,
            **context,
        )

    with _served(make) as (node, executor):
        abort = node.create_client(AbortTrial, topics.ABORT_SERVICE)
        calls = {
            key: (node.create_client(Trigger, name), Trigger.Request())
            for key, name in (("p", topics.PAUSE_SERVICE), ("", topics.RESUME_SERVICE), ("r", topics.REPEAT_SERVICE))
        } | {"a": (abort, AbortTrial.Request(reason="aborted by the operator"))}

        def done() -> bool:
            while not keys.empty():
                client, request = calls.get(keys.get(), (None, None))
                if client is not None and client.service_is_ready():
                    client.call_async(request)
            # Where the operator chooses, the pages stay until there is another session.
            return node.choice is not None or (node.over and setting.studies is None)

        if not _serve(executor, graph, done, node.progress):
            print(f"error: the graph ended before the session did:\n{graph.last_words()}", file=sys.stderr)
            return 1, None
        if node.choice is not None:
            _linger(executor)
        return 0, node.choice


@contextmanager
def _served(make: Callable[..., Any]) -> Iterator[tuple[Any, Any]]:
    """A node with a context of its own, and its executor."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from rig_runtime.run import make_executor

    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = make(context=context)
    executor = make_executor(context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def _serve(executor: Any, graph: GraphProcess, done: Callable[[], bool], words: Callable[[], str]) -> bool:
    """Until it is done, with a line that says how far it is; False if the graph ended before."""
    line = Line()
    with Interrupts() as interrupts:
        while not done():
            interrupts.check()
            if graph.exit_code is not None:
                return False
            executor.spin_once(timeout_sec=0.1)
            line.show(words())
    line.show(words(), last=True)
    return True


def _linger(executor: Any) -> None:
    """Until the pages have been told what begins."""
    end = time.monotonic() + _FAREWELL
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)


@cache
def _keys() -> queue.SimpleQueue[str]:
    """What is typed, line by line, where somebody can type."""
    typed: queue.SimpleQueue[str] = queue.SimpleQueue()
    if os.isatty(0):
        threading.Thread(target=lambda: [typed.put(text.strip()) for text in sys.stdin], daemon=True).start()
    return typed

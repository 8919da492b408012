"""`./rig up`: a trial on the live graph, recorded and reported."""

from __future__ import annotations

import argparse
import os
import secrets
import socket
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from ament_index_python.packages import get_package_prefix

from rig_bringup import scenario
from rig_bringup.graph_process import GraphProcess
from rig_bringup.interrupts import Interrupts
from rig_bringup.scenario import Checked, ScenarioError
from rig_display.parameters import DisplayConfig
from rig_runtime.claim import Claim, ClaimError
from shared_control.parameters import ParameterError, build

if TYPE_CHECKING:
    from rig_bringup.replay import Replay

DEFAULT_SCENARIO = "cart_pendulum_noise_assistance"

Sampler = Callable[[GraphProcess], None]

#: [s] How long the nodes may take to be ready, and the recorder to close its bag.
_READY_LIMIT = 60.0
_CLOSE_LIMIT = 30.0


def parser() -> argparse.ArgumentParser:
    """The command line of `./rig up`."""
    result = argparse.ArgumentParser(
        prog="./rig up",
        description="Run one trial on the live ROS 2 graph: start the nodes, wait until all endpoints match, run, "
        "record to a bag, report. Ctrl-C at any moment leaves a closed, readable bag and no process behind.",
        epilog="environment: RIG_REALTIME=off|auto|require asks for real-time scheduling and locked memory in trials "
        "paced by wall time (auto: what is permitted; ./rig doctor says what is), RIG_CPUS=0,2-3|all|one for "
        "processors (all; one for a composed graph in real time, without a page)",
    )
    result.add_argument(
        "scenario", nargs="?", help=f"name under config/, or a path ({DEFAULT_SCENARIO}, or that of --user-from)"
    )
    result.add_argument(
        "--pacing", choices=("realtime", "lockstep"), help="wall time, or as fast as the machine allows"
    )
    result.add_argument("--compose", action="store_true", help="all nodes in one process, on one executor")
    result.add_argument("--duration", type=float, metavar="S", help="length of the trial [s]")
    result.add_argument("--seed", type=int, metavar="N", help="seed of every random stream")
    result.add_argument(
        "--user-from", type=Path, metavar="BAG", help="let the recorded user push, tick by tick, in lockstep"
    )
    person = result.add_argument_group("a person instead of the simulated user")
    person.add_argument(
        "--display", action="store_true", help="serve a page in the browser whose hand pushes; realtime"
    )
    person.add_argument("--port", type=int, metavar="N", help="port of the page (8600)")
    person.add_argument("--host", metavar="ADDR", help="address to listen on (127.0.0.1); any other needs the token")
    person.add_argument(
        "--token", metavar="T", help="what a browser elsewhere must know (made and printed if not given)"
    )
    result.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (default: a new one under runs/)")
    result.add_argument("--namespace", default="rig", help="stands in front of every topic (%(default)s)")
    result.add_argument("--no-report", action="store_true", help="leave the HTML report out")
    return result


def display(argv: Sequence[str]) -> int:
    """As :func:`main`, with a person at the browser page."""
    return main(["--display", *argv])


def main(argv: Sequence[str], sampler: Sampler = lambda graph: None) -> int:
    """Run a trial; 0 if it ran to its end, 130 if it was interrupted, 2 for bad input, 1 for anything else.

    `sampler` is called with the graph again and again while the trial runs.
    """
    arguments = parser().parse_args(argv)
    try:
        check_free(arguments.namespace)
        checked, replay = _load(arguments)
        out = _make_folder(arguments.out, checked.scenario.name)
        if replay is not None:
            checked = replay.place(out)
    except ScenarioError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    bag = out / "bag"
    files = _write_parameters(out, bag, checked)
    loop = checked.loop
    if checked.display is not None:
        print(invitation(checked.display, arguments), flush=True)
        print("Take control and press Start; the trial waits for it.", flush=True)
    print(f"{checked.scenario.name}: {loop.duration:g} s, {loop.pacing}, seed {loop.seed}, in {out}", flush=True)
    code = _run(arguments, files, out, loop.pacing, sampler)
    return _finish(bag, out, code, report=not arguments.no_report)


def check_free(namespace: str, patience: float = 2.0) -> None:
    """Whether a graph may be started in a namespace; waits so long [s] for one that is just ending.

    Raises
    ------
    ScenarioError: there is one already; theirs and ours would answer each other.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    limit = time.monotonic() + patience
    while True:
        try:
            Claim(int(domain), namespace).close()
            return
        except ValueError:
            raise ScenarioError(f"ROS_DOMAIN_ID={domain}: must be a whole number") from None
        except ClaimError as error:
            if time.monotonic() > limit:
                raise ScenarioError(str(error)) from None
            time.sleep(0.05)


def _load(arguments: argparse.Namespace) -> tuple[Checked, Replay | None]:
    given = {"pacing": arguments.pacing, "duration": arguments.duration, "seed": arguments.seed}
    overrides = {key: value for key, value in given.items() if value is not None}
    _check_display(arguments)
    if arguments.user_from is None:
        checked = scenario.load(arguments.scenario or DEFAULT_SCENARIO, overrides, person=arguments.display)
        return _place_display(checked, arguments), None
    # Imported here: it reads bags, which a run without one need not wait for.
    from rig_bringup.replay import Replay

    replay = Replay.of(arguments.user_from, arguments.scenario, overrides)
    return replay.checked, replay


def _check_display(arguments: argparse.Namespace) -> None:
    if arguments.display and arguments.user_from is not None:
        raise ScenarioError("--display and --user-from: either a person pushes or a recording does; leave one out")
    if not arguments.display and any(value is not None for value in (arguments.port, arguments.host, arguments.token)):
        raise ScenarioError("--port, --host and --token are for --display; add it")


def _place_display(checked: Checked, arguments: argparse.Namespace) -> Checked:
    if checked.display is None:
        return checked
    if checked.loop.pacing != "realtime":
        raise ScenarioError("--display: a person cannot be hurried, so pacing must be realtime, not lockstep")
    return replace(checked, display=placed(checked.display, arguments))


def placed(display: dict[str, Any], arguments: argparse.Namespace) -> dict[str, Any]:
    """The display's address from the command line on top of a scenario's; `arguments` get a token where one is needed.

    Raises
    ------
    ScenarioError: an address, a port or a token that is not allowed.
    """
    given = {"host": arguments.host, "port": arguments.port}
    display = {**display, **{key: value for key, value in given.items() if value is not None}}
    from rig_display.gate import Gate, is_loopback

    if arguments.token is None and not is_loopback(display["host"]):
        arguments.token = os.environ.get("RIG_DISPLAY_TOKEN") or secrets.token_urlsafe()
    try:
        build(DisplayConfig, display, "command line")
        Gate(display["host"], arguments.token or "")
    except ParameterError as error:
        raise ScenarioError(str(error)) from None
    return display


def invitation(display: dict[str, Any], arguments: argparse.Namespace) -> str:
    """Where the pages are that are placed so, with the token that they need."""
    host = socket.gethostname() if display["host"] in ("0.0.0.0", "::") else display["host"]  # noqa: S104
    address = f"http://{f'[{host}]' if ':' in host else host}:{display['port']}"
    end = f"?token={quote(arguments.token)}" if arguments.token else ""
    return f"driver    {address}/{end}\noperator  {address}/operator{end}"


def _make_folder(given: Path | None, name: str) -> Path:
    out = given or Path.cwd() / "runs" / f"{name}_{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    try:
        if given is None:
            out = _make_new(out)
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"--out {out}: cannot be made: {error.strerror}") from error
    if (out / "bag").exists():
        raise ScenarioError(f"--out {out}: holds a bag already, and no bag is ever overwritten; name another folder")
    return out.resolve()


def _make_new(folder: Path) -> Path:
    """Make a folder that was not there, numbered where the name is taken: two runs may begin in the same second."""
    made, number = folder, 1
    while True:
        try:
            made.mkdir(parents=True)
            return made
        except FileExistsError:
            number += 1
            made = folder.with_name(f"{folder.name}_{number}")


def _write_parameters(out: Path, bag: Path, checked: Checked) -> list[Path]:
    """The scenario as it was used, and beside it what belongs to this run alone."""
    run: dict[str, dict[str, Any]] = {
        "/**/task_sim": {
            "scenario": checked.scenario.name,
            "configuration_hash": checked.digest(),
            "required_nodes": [
                "user_sim" if checked.display is None else "display",
                "mig_filter",
                "admittance_sim",
                "recorder",
            ],
            # With a person the trial begins from the page.
            "autostart": checked.display is None,
            "ready_timeout": _READY_LIMIT,
        },
        "/**/recorder": {"uri": str(bag), "attachments": [str(out / "scenario.yaml"), *_recordings(checked)]},
    }
    texts = {"scenario.yaml": checked.text(), "run.yaml": scenario.parameter_file(run)}
    for name, text in texts.items():
        (out / name).write_text(text)
    return [out / name for name in texts]


def _recordings(checked: Checked) -> list[str]:
    """Files without which the scenario says too little."""
    return [checked.scenario.user.recording] if checked.scenario.user.recording else []


def graph_command(compose: bool, files: list[Path], namespace: str) -> list[str]:
    """What starts the graph with these parameter files: the script, or all nodes in one process."""
    if not compose:
        script = Path(os.environ["RIG_ROOT"]) / "ros2_ws" / "scripts" / "start_graph.sh"
        return [str(script), *map(str, files)]
    parameters = [part for file in files for part in ("--params-file", str(file))]
    # Without `ros2 run`: that of ros2cli stays in between and passes no signal on.
    executable = Path(get_package_prefix("rig_bringup")) / "lib" / "rig_bringup" / "compose"
    return [str(executable), "--ros-args", "-r", f"__ns:=/{namespace}", *parameters]


def scheduling(pacing: str) -> dict[str, str]:
    """What the graph's processes are to ask for: real time, if the user says nothing else; never in lockstep."""
    return {"RIG_REALTIME": (os.environ.get("RIG_REALTIME") or "auto") if pacing == "realtime" else "off"}


def _run(arguments: argparse.Namespace, files: list[Path], out: Path, pacing: str, sampler: Sampler) -> int:
    environment = {"RIG_NAMESPACE": arguments.namespace, **scheduling(pacing)}
    if arguments.display:
        # By the environment, since the files of a run are kept and a token is not to be.
        environment |= {"RIG_USER": "display", "RIG_DISPLAY_TOKEN": arguments.token or ""}
    command = graph_command(arguments.compose, files, arguments.namespace)
    graph = GraphProcess(command, out / "graph.log", environment)
    try:
        with graph:
            return _watch(graph, arguments.namespace, sampler)
    except KeyboardInterrupt:
        _line_end()
        how = "was killed, for it did not end; see ./rig bag repair" if graph.killed else "has ended, the bag is closed"
        print(f"interrupted: the graph {how}", file=sys.stderr)
        return 130


def _watch(graph: GraphProcess, namespace: str, sampler: Sampler) -> int:
    # Imported while the nodes start: it takes about as long as they do.
    from mig_interfaces.msg import TrialState
    from rig_bringup.monitor import Monitor

    line = Line()
    with Interrupts() as interrupts, Monitor(namespace) as monitor:
        while not monitor.over:
            interrupts.check()
            if graph.exit_code is not None:
                _line_end()
                print(f"error: the graph ended before the trial did; it said:\n{graph.last_words()}", file=sys.stderr)
                return 1
            monitor.wait(0.1)
            line.show(monitor.progress())
            sampler(graph)
        limit = time.monotonic() + _CLOSE_LIMIT
        # In a short trial the one message that tells its pace may be missed; the next comes within a second.
        while not (monitor.bag_closed and monitor.pace_known) and graph.exit_code is None and time.monotonic() < limit:
            interrupts.check()
            monitor.wait(0.1)
        line.show(monitor.progress(), last=True)
        trial, speed = monitor.trial, monitor.speed()
        assert trial is not None
        if speed is not None and trial.pacing == TrialState.PACING_LOCKSTEP:
            print(f"lockstep: {speed:.1f} x real time")
        if trial.phase == TrialState.PHASE_ABORTED:
            print(f"error: the trial was aborted: {trial.message}", file=sys.stderr)
            return 1
        if not monitor.bag_closed:
            print(f"error: the recorder has not closed the bag within {_CLOSE_LIMIT:.0f} s", file=sys.stderr)
            return 1
    return 0


def _finish(bag: Path, out: Path, code: int, *, report: bool) -> int:
    if not (bag / "metadata.yaml").exists():
        if code != 130:
            print(f"no bag was written; the graph's output is in {out / 'graph.log'}", file=sys.stderr)
        return code or 1
    from rig_bag import BagError
    from rig_study.recorded import TrialError
    from rig_study.trial_report import summarize, write_report

    print(f"\nbag     {bag}")
    try:
        print(summarize(bag))
        if report:
            print(f"report  {write_report(bag, out / 'report.html')}")
    except (TrialError, BagError) as error:
        # A trial that was interrupted before its first tick has nothing to report.
        print(f"note: no report: {error}", file=sys.stderr)
    return code


class Line:
    """A progress line: rewritten in place on a terminal, a line every five seconds elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._next = 0.0
        self._last = ""

    def show(self, text: str, *, last: bool = False) -> None:
        now = time.monotonic()
        if (text == self._last and not last) or (now < self._next and not last):
            return
        self._last = text
        self._next = now + (0.1 if self._terminal else 5.0)
        ends = ("\r\033[K", "\n" if last else "") if self._terminal else ("", "\n")
        print(f"{ends[0]}{text}", end=ends[1], file=sys.stderr, flush=True)


def _line_end() -> None:
    if sys.stderr.isatty():
        print(file=sys.stderr)

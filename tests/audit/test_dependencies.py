"""What is installed, against what the lists of requirements and docs/dependencies.md say. Without a network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
LISTS = sorted((ROOT / "src" / "rig_bringup" / "requirements").glob("*.txt"))
PAGE = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")

#: What a virtual environment is made with.
_ITS_OWN = {"pip", "uv"}


def required(path: Path) -> Iterator[Requirement]:
    """The requirements of a list."""
    for line in path.read_text(encoding="utf-8").splitlines():
        text = line.partition("#")[0].strip()
        if text:
            yield Requirement(text)


def installed() -> dict[str, Distribution]:
    """Every distribution that was installed into this environment, by name."""
    found = {}
    for distribution in distributions():
        name = distribution.metadata["Name"]
        # Without a record: the rig's own, and what came inside a ROS wheel, which stands for it.
        if name and distribution.read_text("RECORD") is not None:
            found.setdefault(canonicalize_name(name), distribution)
    return found


@pytest.mark.parametrize("path", LISTS, ids=lambda path: path.name)
def test_every_requirement_is_bounded_and_met(path: Path) -> None:
    there = installed()
    for requirement in required(path):
        operators = {part.operator for part in requirement.specifier}
        assert "==" in operators or ({">=", "<"} <= operators), (
            f"{path.name}: {requirement} has no bounds on both sides"
        )
        found = there.get(canonicalize_name(requirement.name))
        if found is None and path.name.startswith("ros"):
            continue  # an installation of ROS 2 brings its own
        assert found is not None, f"{path.name}: {requirement.name} is not installed"
        assert requirement.specifier.contains(found.version, prereleases=True), f"{requirement}: {found.version}"


@pytest.mark.parametrize("path", [path for path in LISTS if path.name != "ros.txt"], ids=lambda path: path.name)
def test_every_requirement_has_its_line_in_the_docs(path: Path) -> None:
    words = {canonicalize_name(word.partition("[")[0]) for word in re.findall(r"`([\w.-]+(?:\[\w+\])?)`", PAGE)}
    for requirement in required(path):
        assert canonicalize_name(requirement.name) in words, f"docs/dependencies.md does not say why {requirement.name}"


def test_everything_that_is_installed_is_required_by_something() -> None:
    there = installed()
    waiting = [canonicalize_name(requirement.name) for path in LISTS for requirement in required(path)]
    explained: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in explained or name not in there:
            continue
        explained.add(name)
        # Extras are taken as asked for: more is explained then, nothing is left out.
        waiting += [canonicalize_name(Requirement(text).name) for text in there[name].requires or ()]
    # A sourced ROS installation has packages of its own beside this environment, which set-up has not installed.
    ours = {name for name, found in there.items() if (ROOT / ".venv") in Path(str(found.locate_file(""))).parents}
    assert "numba" in ours
    unexplained = {name for name in ours if name not in explained | _ITS_OWN and not name.startswith("ros-")}
    assert not unexplained, f"nobody requires {sorted(unexplained)}"


def test_every_distribution_states_its_licence() -> None:
    for name, distribution in installed().items():
        metadata = distribution.metadata
        classifiers = [text for text in metadata.get_all("Classifier") or [] if text.startswith("License ::")]
        files = [path for path in distribution.files or () if re.match(r"(?i)(licen[cs]e|copying)", path.name)]
        stated = metadata.get("License") or metadata.get("License-Expression") or classifiers or files
        assert stated or name.startswith("ros-"), f"{name} states no licence"

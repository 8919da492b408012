"""YAML files of named sections, each checked against a dataclass of declared parameters."""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from shared_control import scenario as science
from shared_control import yaml_text
from shared_control.parameters import ParameterError, build, declarations, shown
from shared_control.scenario import Scenario

__all__ = ["DeclaredFile", "StudyError", "base_scenario", "folders", "load", "section", "sections"]

T = TypeVar("T")


class StudyError(ParameterError):
    """A protocol, cohort or sweep is missing or says what is not allowed. The message is for a person."""


@dataclass(frozen=True)
class DeclaredFile:
    """What was read, and from where."""

    path: Path
    text: str
    content: Mapping[str, Any]

    @property
    def sha256(self) -> str:
        """Hash of the text as it was read."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def load(kind: str, name: str | os.PathLike[str], known: tuple[str, ...]) -> DeclaredFile:
    """Read a file by its path, or by its name under ``config/<kind>/``.

    Raises
    ------
    StudyError: no such file (what there is, is listed), not YAML (with the line), or a section that is not ``known``.
    """
    path = _find(kind, name)
    try:
        raw, content = yaml_text.read(path)
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise StudyError(f"{path}: cannot be read: {error}") from None
    except ParameterError as error:
        raise StudyError(str(error)) from None
    if not isinstance(content, Mapping):
        raise StudyError(f"{path}: must be a mapping of sections: {', '.join(known)}")
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            raise StudyError(
                f"{path}: unknown section {key}; "
                + (f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}")
            )
    return DeclaredFile(path, text, content)


def folders(kind: str) -> list[Path]:
    """Where files of a kind are found by their names."""
    return [folder / kind for folder in science.folders()]


def _find(kind: str, name: str | os.PathLike[str]) -> Path:
    with contextlib.suppress(OSError):  # of a name that is too long
        if Path(name).is_file():
            return Path(name)
    try:
        return science.find(Path(kind) / name)
    except science.ScenarioError:
        pass
    there = [path.stem for folder in folders(kind) for path in folder.glob("*.yaml")]
    listing = f"there are: {', '.join(sorted(set(there)))}" if there else "none is there"
    raise StudyError(f"{kind}: {shown(os.fspath(name))} is neither a file nor a name under config/{kind}; {listing}")


def base_scenario(file: DeclaredFile, name: str, part: str) -> Scenario:
    """The scenario that a section of a file names.

    Raises
    ------
    StudyError: it is not there or not allowed; the message names file and section too.
    """
    try:
        return science.load(name)
    except ParameterError as error:
        raise StudyError(f"{file.path}: {part}: {error}") from None


def section(file: DeclaredFile, name: str, cls: type[T]) -> T:
    """One section as a dataclass; its defaults if the section is not there.

    Raises
    ------
    StudyError: an unknown key or a value that is refused; the message names file, section, key, value and range.
    """
    return _build(file.content.get(name) or {}, cls, f"{file.path}: {name}")


def sections(file: DeclaredFile, name: str, cls: type[T]) -> dict[str, T]:
    """A section that holds named parts of one kind, in their order.

    Raises
    ------
    StudyError: as :func:`section`; or there is no part.
    """
    parts = file.content.get(name)
    if not isinstance(parts, Mapping) or not parts:
        raise StudyError(f"{file.path}: {name}: at least one is needed, as in '{name}: {{a: {{...}}}}'")
    return {str(key): _build(body or {}, cls, f"{file.path}: {name}.{key}") for key, body in parts.items()}


def _build(body: Any, cls: type[T], where: str) -> T:
    if not isinstance(body, Mapping):
        raise StudyError(f"{where}: must be a mapping of keys to values, not {shown(body)}")
    values = {str(key): value for key, value in body.items()}
    try:
        return build(cls, values, where)
    except ParameterError as error:
        # YAML takes a bare off for false.
        words = [known.name for known in declarations(cls) if known.choices]
        hint = any(isinstance(value, bool) for key in words for value in _flat(values.get(key)))
        raise StudyError(f"{error}" + (' (YAML reads a bare off as false: write "off")' if hint else "")) from None


def _flat(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]

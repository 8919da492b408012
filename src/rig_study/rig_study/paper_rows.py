"""What the paper reports of its study, line by line, beside the ``statistics.json`` of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rig_study.results_page import Row

__all__ = ["paper_rows"]

Found = Mapping[str, Any]

_RATE = "success_rate"
_SKILLS = (_RATE, "balance_time", "time_to_success")
_ALL = ("success_rate", "rms_error", "balance_time", "time_to_success")
_SHORT = {"success_rate": "success", "rms_error": "RMS", "balance_time": "balance", "time_to_success": "time"}


def paper_rows(found: Found) -> list[Row]:
    """Question, the paper's answer, this study's. The paper's by-trials tests are beside those of subjects' means."""
    first, last = found["sets"]
    within = sorted({key.split(", ")[1] for key in found["two_sample"] if key.count(", ") == 2} - {first, last})
    mixed, flat = found["mixed_anova"], found["factorial_anova"]
    change = {group: found["paired"][f"{_RATE}, {group}, {last} less {first}"] for group in found["groups"]}
    skill = "{}, {} of " + first + ", PRA of trials"
    rows = [
        ("success rate, set 1 and set 3", "0.14, 0.28",
         _each(change, lambda t: f"{t['mean'][1]:.2f}, {t['mean'][0]:.2f}")),
        ("r of PRA (trials) with success rate, balance time, time to success, all of set 1", "-0.14, -0.09, 0.11",
         ", ".join(_r(found["correlation"][skill.format(m, "all trials")]) for m in _SKILLS)),
        ("the same, last ten trials of set 1", "-0.20, -0.13, 0.21",
         ", ".join(_r(found["correlation"][skill.format(m, "last 10 trials")]) for m in _SKILLS)),
        ("set, RMS error", "F(1, 26) = 41.55, p < 0.001", _f(mixed["rms_error"], "set")),
        ("set, balance time, time to success", "F(1, 26) = 15.33, 18.99; p < 0.001",
         "; ".join(_f(mixed[m], "set") for m in _SKILLS[1:])),
        ("group x set, RMS error", "F(1, 26) = 5.10, p = 0.033", _f(mixed["rms_error"], "interaction")),
        ("group x set, balance time, time to success", "p = 0.315, 0.230", _ps(mixed, "interaction", _SKILLS[1:])),
        ("group, RMS error, balance time, time to success", "p = 0.215, 0.223, 0.301", _ps(mixed, "group", _ALL[1:])),
        ("success rate, factorial form: group, set, group x set", "F(1, 50) = 0.98, 7.56 (p = 0.008), 0.11",
         "; ".join(_f(flat[_RATE], effect) for effect in ("group", "set", "interaction"))),
        ("change of success rate, t", "control t(9) = 3.15, p = 0.012; training t(17) = 3.13, p = 0.006",
         _each(change, lambda t: f"t({t['df']:.0f}) = {t['t']:.2f}, {_p(t['p'])}")),
        ("change of success rate, d", "control 0.77, training 0.94", _each(change, lambda t: f"{t['d']:.2f}")),
        ("groups in set 1", "no difference in any measure", _groups(found, first)),
        ("groups in set 3", ("training better by trials in balance time (p < 0.001), time to success (p = 0.002), RMS "
         "error, not in success rate"), _groups(found, last)),
    ]  # fmt: skip
    rows += [("groups in set 2", "the filter helps RMS error alone", _groups(found, set_)) for set_ in within]
    return rows


def _each(tests: Found, say: Any) -> str:
    return "; ".join(f"{group} {say(test) if 'error' not in test else '-'}" for group, test in tests.items())


def _p(p: float | None) -> str:
    return "-" if p is None else "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def _r(test: Found) -> str:
    return f"{test['r']:.2f} ({_p(test['p'])})" if "r" in test else "-"


def _f(analysis: Found, effect: str) -> str:
    if "error" in analysis:
        return "-"
    row = analysis["effects"][effect]
    return f"F({row['df']:g}, {row['error_df']:g}) = {row['f']:.2f}, {_p(row['p'])}"


def _ps(analyses: Found, effect: str, measures: Sequence[str]) -> str:
    return ", ".join(_p(analyses[m]["effects"][effect]["p"]) if "effects" in analyses[m] else "-" for m in measures)


def _groups(found: Found, set_: str) -> str:
    """p of the difference of the groups in one set, by trials and by subjects, measure by measure."""
    said = []
    for key, by in (("two_sample_of_trials", "by trials"), ("two_sample", "by subjects")):
        tests = {name.split(", ")[0]: test for name, test in found[key].items() if name.split(", ")[1:2] == [set_]}
        said.append(f"{by} " + ", ".join(f"{_SHORT[m]} {_p(tests[m].get('p'))}" for m in _ALL if m in tests))
    return "; ".join(said)

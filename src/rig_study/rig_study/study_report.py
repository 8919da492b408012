"""The report of a study, a Monte Carlo run or a sweep: one self-contained page, and its figures as files."""

from __future__ import annotations

import html
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from rig_study import study_figures as figures
from rig_study.figure_style import save
from rig_study.recorded import load
from rig_study.study_statistics import MEASURES
from rig_study.tables import Gathered, subjects

__all__ = ["write"]

_STYLE = """
 body { font: 16px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; color: #222;
        background: #fff }
 h1 { font-size: 1.6rem; margin-bottom: 0 } h2 { font-size: 1.2rem; margin-top: 2.2rem }
 table { border-collapse: collapse; margin: .7rem 0 1.4rem } caption { text-align: left; font-weight: 600 }
 th, td { padding: .15rem 1.4rem .15rem 0; text-align: right; border-bottom: 1px solid #ddd;
          white-space: nowrap }
 th:first-child, td:first-child { text-align: left; white-space: normal; min-width: 8rem }
 th { color: #555; font-weight: 500 }
 .wide { overflow-x: auto }
 figure { margin: 0 0 1rem } svg { max-width: 100%; height: auto } figcaption, .note { color: #555; max-width: 60rem }
"""

_RESTS = (
    "Normality: p of Shapiro and Wilk's test, of the residuals, of the changes, or of each of two samples; a small p "
    "speaks against it. Sphericity: between two sets there is one difference only, so it cannot fail. "
    "p, Holm: corrected for all tests of the table."
)


def write(gathered: Gathered, statistics: Mapping[str, Any], out: Path) -> Path:
    """Write ``report.html`` and ``figures/``; the same inputs give the same bytes."""
    trials = gathered.trials
    parts = [f"<p>{len(trials)} trials; {len(gathered.left_out)} left out.</p>"]
    study = statistics.get("study")
    if study:
        parts += _study(trials, study, out)
    else:
        parts += _conditions(trials, out)
    shown = _example(gathered)
    if shown is not None:
        name, figure = shown
        caption = f"Trial {name}. Above: the user's force, what the filter allowed filled. Below: success in green."
        parts.append(_figure(figure, out, "example_trial", "An example", caption))
    parts.append(f"<h2>Trials left out</h2><p class='note'>{html.escape(statistics['rule'])}</p>")
    parts.append(_table(("trial", "why"), gathered.left_out) if gathered.left_out else "<p>None.</p>")
    title = "Study" if study else "Trials"
    page = out / "report.html"
    page.write_text(
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{title}</title><style>{_STYLE}</style>\n'
        f"<h1>{title}</h1>\n" + "\n".join(parts) + "\n</html>\n",
        encoding="utf-8",
    )
    return page


def _study(trials: pd.DataFrame, study: Mapping[str, Any], out: Path) -> Iterator[str]:
    means, (first, last) = subjects(trials), study["sets"]
    sizes = ", ".join(f"{group} {n}" for group, n in study["groups"].items())
    yield f"<p>Subjects: {html.escape(sizes)}. Compared: {html.escape(first)} and {html.escape(last)}.</p>"
    caption = (
        "Means over subjects with standard errors. Marks: the groups differ in this set (Welch's t, corrected by "
        "Holm's method), * p < 0.05, ** p < 0.01, *** p < 0.001."
    )
    yield _figure(figures.group_bars(means, dict(study)), out, "groups", "Groups and sets", caption)
    filtered = set(zip(*(trials[trials["mode"] != "off"][column] for column in ("group", "set")), strict=True))
    yield "<h2>Means over subjects (SD)</h2>" + _means(means, filtered)
    yield f"<h2>What the tests rest on</h2><p class='note'>{_RESTS}</p>"
    for key, title in (
        ("mixed_anova", "Group between subjects, set within them (mixed analysis of variance)"),
        ("factorial_anova", "The factorial form: every value taken as independent"),
    ):
        yield f"<h2>{title}</h2>" + _anova(study[key])
    yield "<h2>Change within each group (paired t)</h2>" + _tests(study["paired"])
    yield "<h2>Groups in each set (Welch's t, by subjects)</h2>" + _tests(study["two_sample"])
    note = "<p class='note'>As the paper did it. Trials of one subject are not independent: these p are too small.</p>"
    yield f"<h2>Groups in each set, by trials</h2>{note}" + _tests(study["two_sample_of_trials"])
    figure = figures.rejection_and_skill(trials, first)
    if figure is not None:
        caption = "Each trial under the filter, against what its subject reached alone before."
        yield _figure(figure, out, "pra_and_skill", "Rejected actions and skill", caption)
        yield _correlations(study["correlation"])


def _conditions(trials: pd.DataFrame, out: Path) -> Iterator[str]:
    by = [column for column in trials.columns if "." in column and not column.startswith("trace")]
    # What is the same in all conditions tells none from another.
    by = [column for column in by if trials[column].nunique(dropna=False) > 1] or by[:1]
    count = trials.groupby(by, dropna=False).ngroups if by else 0
    for column in [column for column in by if trials[column].nunique() == 1]:
        others = [other for other in by if other != column]
        if others and trials.groupby(others, dropna=False).ngroups == count:
            by = others
    by = by or [column for column in ("scenario",) if column in trials]
    trials = trials.assign(
        **{column: trials[column].astype(object).where(trials[column].notna(), "-") for column in by}
    )
    candidates = ("success", "pra", "rms_error", "fell", "override", "mean_speed")
    measures = [column for column in candidates if column in trials and trials[column].notna().any()]
    if by and measures:
        chosen = trials.assign(**{name: trials[name].astype(float) for name in measures})
        summary = chosen.groupby(by, sort=False)[measures].agg(["mean", "sem"])
        head = (*by, *(figures.named(name) for name in measures))
        rows = [
            (*(index if isinstance(index, tuple) else (index,)), *(f"{values[m, 'mean']:.3f}" for m in measures))
            for index, values in summary.iterrows()
        ]
        yield "<h2>Means</h2>" + _table(head, rows)
        caption = "Means over trials with standard errors; the same seeds in each condition."
        if len(rows) > 1:
            yield _figure(figures.comparison(trials, by, measures[:3]), out, "comparison", "Conditions", caption)
    figure = figures.running(trials, by) if by else None
    if figure is not None:
        caption = "The first trial of each condition. Broad and orange: the filter overrode the user; dashed: the fall."
        yield _figure(figure, out, "running", "Height and speed", caption)
    figure = figures.convergence(trials) if not by or len(trials.groupby(by)) == 1 else None
    if figure is not None:
        caption = "Each trial in grey; median and quartiles in blue, of an angle those of its magnitude."
        yield _figure(figure, out, "convergence", f"{len(trials)} trials", caption)


def _example(gathered: Gathered) -> tuple[str, Figure] | None:
    """The first recorded trial that succeeded under the filter, or the first there is."""
    trials = gathered.trials
    recorded = trials[trials["name"].isin(gathered.bags)]
    if recorded.empty:
        return None
    best = recorded[(recorded.get("success", False) == True) & (recorded["mode"] != "off")]  # noqa: E712
    name = str((best if len(best) else recorded)["name"].iloc[0])
    return name, figures.example(figures.Example.recorded(load(gathered.bags[name])))


def _figure(figure: Figure, out: Path, name: str, title: str, caption: str) -> str:
    svg = save(figure, out / "figures" / name)
    return f"<h2>{title}</h2><figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    top = "".join(f"<th>{html.escape(str(cell))}" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(str(cell))}" for cell in row) for row in rows)
    return f"<div class='wide'><table><tr>{top}{body}</table></div>"


def _means(means: pd.DataFrame, filtered: Collection[tuple[str, str]]) -> str:
    """A row for each group and set; PRA where there was a filter."""
    measures = [name for name in (*MEASURES, "pra") if name in means]
    rows = []
    for (group, set_), its in means.groupby(["group", "set"]):
        cells = (
            "-" if name == "pra" and (group, set_) not in filtered
            else f"{its[name].mean():.3f}" + (f" ({its[name].std():.3f})" if len(its) > 1 else "")
            for name in measures
        )  # fmt: skip
        rows.append((f"{group}, {set_}", len(its), *cells))
    return _table(("group, set", "subjects", *map(figures.named, measures)), rows)


def _p(value: float | None) -> str:
    return "-" if value is None else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _anova(analyses: Mapping[str, Any]) -> str:
    rows, notes = [], []
    for measure, found in analyses.items():
        name = MEASURES[measure][0]
        if "error" in found:
            notes.append(f"{name}: {found['error']}")
            continue
        for effect, row in found["effects"].items():
            interval = f"{row['eta']:.3f} ({row['eta_low']:.3f} to {row['eta_high']:.3f})"
            df = f"{row['df']:g}, {row['error_df']:g}"
            rows.append((name, effect, f"{row['f']:.3f}", df, _p(row["p"]), interval, _normality(found)))
    head = ("measure", "effect", "F", "df", "p", "partial eta² (95 %)", "normality, p")
    return (_table(head, rows) if rows else "") + _notes(notes)


def _tests(tests: Mapping[str, Any]) -> str:
    rows = []
    for name, row in _done(tests):
        change = f"{row['difference']:.3f} ({row['low']:.3f} to {row['high']:.3f})"
        d = f"{row['d']:.2f} ({row['d_low']:.2f} to {row['d_high']:.2f})" if row["d_low"] is not None else "-"
        t = f"{row['t']:.3f}", f"{row['df']:.1f}", _p(row["p"]), _p(row.get("p_holm"))
        rows.append((name, change, *t, d, _normality(row)))
    head = ("test", "difference (95 %)", "t", "df", "p", "p, Holm", "d (95 %)", "normality, p")
    return (_table(head, rows) if rows else "") + _notes(_not_done(tests))


def _normality(found: Mapping[str, Any]) -> str:
    return "; ".join(_p(p) for _, p in found["normality"])


def _done(tests: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return [(_readable(key), row) for key, row in tests.items() if "error" not in row]


def _not_done(tests: Mapping[str, Any]) -> list[str]:
    return [f"{_readable(key)}: {row['error']}" for key, row in tests.items() if "error" in row]


def _readable(key: str) -> str:
    """A test's name, with that of its measure as a reader has it."""
    measure, comma, rest = key.partition(",")
    return MEASURES.get(measure, (measure,))[0] + comma + rest


def _notes(notes: Sequence[str]) -> str:
    return f"<p class='note'>{'<br>'.join(map(html.escape, notes))}</p>" if notes else ""


def _correlations(tests: Mapping[str, Any]) -> str:
    rows = []
    for name, row in _done(tests):
        interval = f"{row['r']:.3f} ({row['low']:.3f} to {row['high']:.3f})"
        rows.append((name, interval, row["n"], _p(row["p"]), _p(row["p_holm"])))
    return (_table(("skill and PRA", "r (95 %)", "n", "p", "p, Holm"), rows) if rows else "") + _notes(_not_done(tests))

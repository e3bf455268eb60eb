"""One solver beside others, for its author: a comment on a pull request, and its worst steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.records.run_steps import Measure
from dpbench.analysis.records.worst_steps import WorstStep, value_at, worst_steps
from dpbench.analysis.times.pairs import paired_comparison
from dpbench.analysis.verdict.fastest import best_of_each, fastest_first
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.errors import UnknownNameError, one_of
from dpbench.report.documents.markdown import cut, solver_table
from dpbench.report.escaped import markdown_line, markdown_text, one_line
from dpbench.report.formats import and_list, count_text, error_text, time_text
from dpbench.report.page.data import PageData
from dpbench.report.report import Report
from dpbench.report.table import markdown
from dpbench.report.verdict_text import answer_text, clauses, paired_text, requirements_text

USUAL = ("osqp", "daqp")
"""Whom a solver is set beside, where nobody is named."""
MOST_BYTES = 3000
"""A comment that is read without scrolling."""
MOST_CONFIGURATIONS = 3
"""So many configurations of the solver itself have a row."""


def beside(report: Report, solver: str, others: Sequence[str] = ()) -> tuple[str, list[WorstStep]]:
    """Compare one solver with others in `MOST_BYTES` of Markdown; also return its worst steps.

    Parameters
    ----------
    others : solvers to compare with; by default those of `USUAL` that ran.

    Raises
    ------
    InputError : for a solver that was not run.
    """
    data, machine = report.data, report.recommendation.machine
    best = {v.configuration.solver: v for v in best_of_each(data.verdicts)}
    for option, name in (("--for", solver), *(("--against", other) for other in others)):
        if name not in best:
            raise UnknownNameError(option, "", repr(name), one_of(name, sorted(best)))
    named = others or [name for name in USUAL if name in best]
    chosen = [best[name] for name in dict.fromkeys(named) if name != solver]
    worst = worst_steps(data.records, solver)
    own = fastest_first([v for v in data.verdicts.of[solver] if v.state != "not run"])
    names = and_list([v.configuration.solver for v in chosen]) or "nobody"
    parts = [
        f"# {markdown_text(solver)} beside {markdown_text(names)}",
        markdown_line(_sentence(data, best[solver])),
        solver_table(data, [*own[:MOST_CONFIGURATIONS], *chosen]),
        "\n".join(f"- {markdown_text(_paired(data, best[solver], v))}" for v in chosen),
        _worst_table(data, worst, chosen),
        "\n".join(f"    {one_line(step.export)}" for step in worst),
        markdown_line(f"{requirements_text(data.requirements)} {_made_by(report)} {machine}"),
    ]
    return cut("\n\n".join(part for part in parts if part) + "\n", MOST_BYTES, "report.md"), worst


def _sentence(data: PageData, verdict: Verdict) -> str:
    label = verdict.configuration.label
    passed = f"`{label}` passes everywhere it was run."
    if verdict.causes:
        verb = "is late" if verdict.state == "late" else "fails"
        return f"`{label}` {verb}: {clauses(verdict.causes)}."
    said = clauses(verdict.missing)
    return passed if verdict.state == "pass" else f"`{label}` is {verdict.state}: {said}."


def _paired(data: PageData, own: Verdict, other: Verdict) -> str:
    faster, slower = fastest_first([own, other])
    said = paired_text(paired_comparison(data.records, faster, slower))
    names = f"`{slower.configuration.label}` against `{faster.configuration.label}`"
    return f"{names}: {said}."


def _worst_table(data: PageData, worst: Sequence[WorstStep], others: Sequence[Verdict]) -> str:
    if not worst:
        return ""
    names = [verdict.configuration.solver for verdict in others]
    heads = ("worst by", "step", "call mode", "figure", "its median", "answer", *names)
    rows = [
        (
            step.measure,
            f"{step.k} of {step.run.problem}",
            step.run.configuration.options,
            _figure(step.measure, step.value),
            _figure(step.measure, step.median),
            answer_text(step.step, 0),
            *(_figure(step.measure, value_at(data.records, step, v.configuration)) for v in others),
        )
        for step in worst
    ]
    return markdown(heads, rows, 3)


def _figure(measure: Measure, value: float) -> str:
    if measure == "time":
        return time_text(value)
    return error_text(value) if measure == "error" else count_text(value)


def worst_text(worst: Sequence[WorstStep]) -> list[tuple[str, str]]:
    """For the end of a report on a terminal: each worst step, and the command that exports it."""
    return [
        (
            f"worst {step.measure}",
            f"step {step.k} of {step.run.problem} ({step.run.configuration.options}): "
            f"{_figure(step.measure, step.value)}, median {_figure(step.measure, step.median)}; "
            f"{step.export}",
        )
        for step in worst
        if not math.isnan(step.value)
    ]


def _made_by(report: Report) -> str:
    suite = report.results.suite
    return f"Suite {suite.get('name', '')}, dpbench {suite.get('harness_version', '')}."

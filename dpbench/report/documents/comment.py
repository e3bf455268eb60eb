"""One solver beside others, for its author: a comment on a pull request, and its worst steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import MEASURES, Measure, RunSteps, hardest
from dpbench.analysis.times.pairs import paired_comparison
from dpbench.analysis.verdict.fastest import best_of_each, fastest_first
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.judge.rules import median
from dpbench.bench.record.configuration import Configuration
from dpbench.errors import UnknownNameError, one_of
from dpbench.report.documents.markdown import HEAD, cut, solver_row
from dpbench.report.formats import MISSING, and_list, count_text, error_text, time_text
from dpbench.report.page.facts import Facts
from dpbench.report.report import Report
from dpbench.report.table import markdown
from dpbench.report.verdict_text import answer_text, clauses, demand_text, paired_text

USUAL = ("osqp", "daqp")
"""Whom a solver is set beside, where nobody is named."""
MOST_BYTES = 3000
"""A comment that is read without scrolling."""
MOST_WAYS = 3
"""So many configurations of the solver itself have a row."""


@dataclass(frozen=True)
class WorstStep:
    """The hardest step of a solver by one measure, in whichever run it was.

    Parameters
    ----------
    step : the step alone.
    value, median : of the measure, at the step and over its run: ns, iterations, or an error.
    """

    measure: Measure
    run: RunRecord
    step: RunSteps
    value: float
    median: float

    @property
    def k(self) -> int:
        """The step of the run."""
        return int(self.step.k[0])

    @property
    def export(self) -> str:
        """The command that writes this step alone, with its certified optimum."""
        run = self.run
        source = run.description.get("source", {}).get("path") or run.scenario or run.sequence
        k = self.k + int(run.description.get("first", 0))
        return f"dpbench export {source} --at {k} --out worst-{self.measure}.npz"


def beside(report: Report, solver: str, others: Sequence[str] = ()) -> tuple[str, list[WorstStep]]:
    """One solver beside others as Markdown of at most `MOST_BYTES`, and its worst steps.

    Parameters
    ----------
    others : whom to set it beside; by default those of `USUAL` that ran.

    Raises
    ------
    InputError : for a solver that was not run.
    """
    facts = report.facts
    best = {v.configuration.solver: v for v in best_of_each(facts.verdicts)}
    for option, name in (("--for", solver), *(("--against", other) for other in others)):
        if name not in best:
            raise UnknownNameError(option, "", repr(name), one_of(name, sorted(best)))
    named = others or [name for name in USUAL if name in best]
    chosen = [best[name] for name in dict.fromkeys(named) if name != solver]
    worst = worst_steps(facts, solver)
    own_ways = fastest_first([v for v in facts.verdicts.of[solver] if v.outcome != "not run"])
    rows = [solver_row(verdict) for verdict in [*own_ways[:MOST_WAYS], *chosen]]
    names = and_list([v.configuration.solver for v in chosen]) or "nobody"
    parts = [
        f"# {solver} beside {names}",
        _sentence(facts, best[solver]),
        markdown(HEAD, rows, 3),
        "\n".join(f"- {_paired(facts, best[solver], other)}" for other in chosen),
        _worst_table(facts, worst, chosen),
        "\n".join(f"    {step.export}" for step in worst),
        f"{demand_text(facts.demand)} {_made_by(report)} {report.answer.machine}",
    ]
    return cut("\n\n".join(part for part in parts if part) + "\n", MOST_BYTES, "report.md"), worst


def worst_steps(facts: Facts, solver: str) -> list[WorstStep]:
    """The hardest step of a solver by error, time and iterations, each once; in its replays, whose
    QPs are those that `export` writes, or else in its loops."""
    runs = {run.run_id: run for run in facts.records.runs if run.solver == solver}
    worst_of_run = {
        run_id: _worst_of(runs[run_id], steps)
        for run_id, steps, _ in facts.records.run_steps(list(runs.values()))
    }
    stepped = [run_id for run_id in runs if run_id in worst_of_run]
    timed = [run_id for run_id in stepped if runs[run_id].mode == "replay"]
    worst: list[WorstStep] = []
    for measure in sorted(MEASURES, key=lambda name: name != "error"):
        of_runs = [worst_of_run[run_id] for run_id in timed or stepped]
        candidates = [of_run[measure] for of_run in of_runs if measure in of_run]
        if candidates:
            worst.append(max(candidates, key=lambda step: step.value))
    return worst


def _worst_of(run: RunRecord, steps: RunSteps) -> dict[Measure, WorstStep]:
    """The hardest step of a run by each measure that it has."""
    worst: dict[Measure, WorstStep] = {}
    for measure in MEASURES:
        for hard in hardest(steps, measure, 1):
            alone, usual = steps.at(np.array([hard.at])), median(steps.values(measure))
            worst[measure] = WorstStep(measure, run, alone, hard.value, usual)
    return worst


def _sentence(facts: Facts, verdict: Verdict) -> str:
    label = verdict.configuration.label
    held = f"`{label}` meets the demand everywhere it was run."
    if verdict.causes:
        return f"`{label}` misses the demand: {clauses(verdict.causes)}."
    said = clauses(verdict.missing)
    return held if verdict.outcome == "meets" else f"`{label}` contradicts nothing; open: {said}."


def _paired(facts: Facts, own: Verdict, other: Verdict) -> str:
    faster, slower = fastest_first([own, other])
    said = paired_text(paired_comparison(facts.records, faster, slower))
    names = f"`{slower.configuration.label}` against `{faster.configuration.label}`"
    return f"{names}: {said}."


def _worst_table(facts: Facts, worst: Sequence[WorstStep], others: Sequence[Verdict]) -> str:
    """Its worst steps, with the same figure of the others at the same step."""
    if not worst:
        return ""
    names = [verdict.configuration.solver for verdict in others]
    heads = ("worst by", "step", "way", "figure", "its median", "answer", *names)
    rows = [
        (
            step.measure,
            f"{step.k} of {step.run.problem}",
            step.run.configuration.options,
            _figure(step.measure, step.value),
            _figure(step.measure, step.median),
            answer_text(step.step, 0),
            *(_of_other(facts, step, verdict.configuration) for verdict in others),
        )
        for step in worst
    ]
    return markdown(heads, rows, 3)


def _of_other(facts: Facts, worst: WorstStep, configuration: Configuration) -> str:
    """The same figure of another configuration at the same step."""
    place = worst.run.mode, worst.run.problem, worst.run.units
    for run in facts.records.runs:
        same = (run.mode, run.problem, run.units) == place
        if not same or run.configuration.in_common_formulation != configuration:
            continue
        for _, steps, _ in facts.records.run_steps([run]):
            at = np.flatnonzero(steps.k == worst.k)
            if len(at):
                return _figure(worst.measure, float(steps.values(worst.measure)[at[0]]))
    return MISSING


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

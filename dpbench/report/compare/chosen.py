"""Comparison of chosen configurations within one result folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.times.chosen_pairs import compare_chosen
from dpbench.analysis.times.paired_times import PairedComparison
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.analysis.verdict.verdict import Verdict, judge_solvers
from dpbench.bench.record.result_folder import load_results
from dpbench.errors import ResultsError
from dpbench.report.commands_text import describe_machine, describe_turns, describe_versions
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_error,
    format_interval,
    format_microseconds,
    join_with_and,
    make_markdown_document,
    strip_markdown,
)
from dpbench.report.ship.ship_text import summarise_ships
from dpbench.report.verdict.verdict_text import describe_paired_times

NOTE = (
    "Second/first: time of the second divided by that of the first on the same steps, timed in "
    "turn; above 1 the second is slower. It is a geometric mean in which replays of one size have "
    "equal weight, with a 95 % interval from 500 steps on. The interval is valid for this run "
    "only; ratios of two runs can differ by more. Windows are not counted. A "
    "configuration that fails also has a ratio, although its answers are not accurate on every "
    "step."
)


@dataclass(frozen=True, eq=False)
class ChosenComparison:
    """Step time ratios of chosen configurations of one result folder, in lines and a table."""

    pairs: Sequence[PairedComparison]
    lines: Sequence[str]
    table: Table

    @property
    def ratios(self) -> pd.DataFrame:
        """Table of the ratios, with the columns of `paired_ratios`."""
        return pd.DataFrame([one.table_row for one in self.pairs])

    def markdown(self) -> str:
        """Return the comparison as a Markdown document."""
        return make_markdown_document("Chosen configurations", self.lines, [self.table])


def compare_configurations_of_folder(
    folder: str | Path, choices: Sequence[str]
) -> ChosenComparison:
    """Return the step time ratios of each two chosen configurations of a result folder.

    Parameters
    ----------
    folder : written by `dpbench run`.
    choices : two or more of a solver, `osqp[rho=1.6]`, `osqp high` or a label of the report.

    Raises
    ------
    InputError : for a choice that was not timed, or fewer than two; as `ResultsError` for a folder
        that is missing, damaged, without steps, or without a step that two of them replayed.
    """
    results = load_results(folder)
    records = Records(results)
    pairs = compare_chosen(records, choices)
    if not pairs:
        found = "no step that two of the chosen configurations replayed"
        raise ResultsError(str(folder), "", found, "configurations that ran the same replay")
    verdicts = judge_solvers(records, Requirements.from_suite(results.suite))
    judged = {v.configuration.label: v for v in verdicts.all_verdicts}
    lines = [summarise_ships(find_ship_results(records)).warning, describe_turns(records)]
    lines += [_describe_pair(one, judged) for one in pairs]
    named = {one.first for one in pairs} | {one.second for one in pairs}
    solvers = {
        v.configuration.solver for v in verdicts.all_verdicts if v.configuration.label in named
    }
    lines += [describe_machine(records, results.machine)]
    lines += [describe_versions(records, results.suite, solvers)]
    rows = [
        {
            "first": one.first,
            "verdict": judged[one.first].state if one.first in judged else MISSING,
            "second": one.second,
            "its verdict": judged[one.second].state if one.second in judged else MISSING,
            "variables": f"{one.variables:.0f}",
            "first, geometric mean [µs]": format_microseconds(one.first_ns),
            "second, geometric mean [µs]": format_microseconds(one.second_ns),
            "second/first": MISSING if one.separate else f"{one.ratio.value:.3f}",
            "interval": MISSING if one.separate else format_interval(one.ratio.low, one.ratio.high),
            "steps": format_count(one.steps),
            "finding": one.finding_text,
        }
        for one in pairs
    ]
    table = Table.from_rows(rows, "Chosen configurations", note=NOTE, text_columns=4)
    return ChosenComparison(pairs, [line for line in lines if line], table)


def _describe_pair(one: PairedComparison, judged: Mapping[str, Verdict]) -> str:
    """Return a line on the ratio of two configurations, their errors, and which does not pass."""
    both = [(name, judged[name]) for name in (one.second, one.first) if name in judged]
    lacking = [f"{name}: {verdict.state}" for name, verdict in both if verdict.state != "pass"]
    errors = [f"{format_error(verdict.error_move)} ({name})" for name, verdict in both]
    listed = join_with_and(errors)
    verdicts = f" Largest errors over all runs, in maximum increments: {listed}." if errors else ""
    verdicts += f" Verdict on {'; on '.join(lacking)}." if lacking else ""
    ratio = f"{strip_markdown(describe_paired_times([one]))}.{verdicts}"
    return f"{one.second} against {one.first} at {one.variables:.0f} variables: {ratio}"

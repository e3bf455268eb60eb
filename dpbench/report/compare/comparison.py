"""Compare two result folders: who became slower, less accurate or a worse pilot."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from dpbench.analysis.compare.answers import Answer, compare_answers
from dpbench.analysis.compare.pairs import Pairs, differences, pair_cells
from dpbench.analysis.compare.times import (
    Compared,
    Shared,
    Timing,
    compare_times,
    compare_to_reference,
    reference_rows,
    reference_solver,
    time_pairs,
    why_unjudged,
)
from dpbench.analysis.records.records import Records
from dpbench.analysis.times.machine import disturbance_of, timed_runs
from dpbench.bench.record.result_folder import load_results
from dpbench.display import table_html
from dpbench.errors import InputError
from dpbench.report.compare.tables import (
    STOPPED,
    answers_table,
    shared_line,
    solvers_table,
    times_table,
)
from dpbench.report.formats import and_list, plural
from dpbench.report.machine_verdict import verdict_text
from dpbench.report.table import Table, document, html

LISTED = 5
"""So many cells without a partner are named."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Verdicts on each configuration from folder A to folder B.

    Parameters
    ----------
    shared : changes that all configurations of a sequence share.
    figures : every figure of accuracy and control; lines : the verdict in a few lines of text.
    margin : ratio that counts as equal; alpha : family-wise error of the claims.
    reference : solver that step times are divided by, "" for none.
    """

    compared: list[Compared]
    shared: list[Shared]
    figures: list[Answer]
    pairs: Pairs
    lines: list[str]
    tables: list[Table]
    margin: float = 0.05
    alpha: float = 0.05
    reference: str = ""

    def __repr__(self) -> str:
        verdict = "a regression" if self.worse else "no regression"
        return f"<Comparison of {plural(len(self.pairs.pairs), 'cell')}: {verdict} shown>"

    def _repr_html_(self) -> str:
        lines = table_html((), [(line,) for line in self.lines], title="Comparison")
        return lines + "".join(html(table) for table in self.tables)

    @property
    def worse(self) -> bool:
        """Whether a regression is shown."""
        together = [s.assessment for s in self.shared if s.assessment is not None]
        slow = any(
            j.verdict == "slower" for j in [*(c.assessment for c in self.compared), *together]
        )
        return slow or any(answer.change == "worse" for answer in self.figures)

    @property
    def times(self) -> pd.DataFrame:
        """One row per configuration and sequence: ratios, interval, adjusted p-values, verdict."""
        return pd.DataFrame([compared.row for compared in self.compared])

    @property
    def answers(self) -> pd.DataFrame:
        """One row per configuration, experiment and figure: identity, ranges in A and B, change."""
        return pd.DataFrame([answer.row for answer in self.figures])

    def markdown(self) -> str:
        """Return the comparison as a Markdown document."""
        return document("Comparison", self.lines, self.tables)


def compare(
    a: str | Path,
    b: str | Path,
    *,
    reference: str | None = None,
    margin: float = 0.05,
    alpha: float = 0.05,
) -> Comparison:
    """Compare folder B with folder A, cell by cell.

    Parameters
    ----------
    a, b : folders written by `dpbench run`; A is the older one, the baseline.
    reference : solver that all step times are divided by. By default none on one machine; on two
        the first of `times.REFERENCES` or else the solver that both have timed most.
    margin : a ratio up to 1 + margin either way makes no difference.
    alpha : family-wise error of the claims on step times.

    Raises
    ------
    InputError : for a margin or alpha out of range, or a reference that was not timed in both; as
        `ResultsError` for a folder that is missing, damaged, or has no cell in common.
    """
    if not (margin > 0.0 and math.isfinite(margin)):
        raise InputError("--margin", "", margin, "a finite number above 0, as 0.05 for 5 %")
    if not 0.0 < alpha < 0.5:
        raise InputError("--alpha", "", alpha, "a number above 0 and below 0.5")
    results = load_results(a, without_steps=True), load_results(b, without_steps=True)
    views = Records(results[0]), Records(results[1])
    pairs = pair_cells(*views, names=(str(a), str(b)))
    differ = differences(results[0].machine, results[1].machine)
    timings = time_pairs(*views, pairs.pairs)
    solver = reference_solver(timings, reference) if differ or reference else ""
    compared, shared, said = _compare_times(views, timings, solver, margin, alpha)
    figures = compare_answers(*views, pairs.pairs, margin)
    lines = [f"A: {a}{_machine(views[0])}", f"B: {b}{_machine(views[1])}"]
    lines += [f"another machine: they differ in {and_list(differ)}"] if differ else []
    lines += [*said, *_lines(compared, shared, figures, pairs)]
    changed = answers_table(figures, margin)
    tables = [solvers_table(compared, figures)] if compared or figures else []
    tables += [times_table(compared, margin, alpha, reference=solver)] if compared else []
    tables += [changed] if changed is not None else []
    return Comparison(compared, shared, figures, pairs, lines, tables, margin, alpha, solver)


def _compare_times(
    views: tuple[Records, Records], timings: list[Timing], solver: str, margin: float, alpha: float
) -> tuple[list[Compared], list[Shared], list[str]]:
    """Compare step times; return verdicts, shared changes, and remarks on the method."""
    said = []
    bare = [name for name, view in zip("AB", views, strict=True) if not view.has_steps]
    if bare and timings:
        said.append(f"no steps.parquet in {and_list(bare)}: medians of step times are compared")
    if not solver:
        unjudged = why_unjudged(*views, timings)
        return *compare_times(timings, margin, alpha, unjudged), said
    rows = reference_rows(timings, solver)
    known = [timings[row] for row in dict.fromkeys(rows.tolist()) if row >= 0]
    took = [f"{math.exp(one.log):.3g} on {one.pair.a.problem}" for one in known]
    said.append(
        f"step times are compared as ratios to {known[0].pair.label}, which takes B/A "
        f"{and_list(took)}"
    )
    return compare_to_reference(timings, margin, alpha, rows), [], said


def _machine(view: Records) -> str:
    said = f", {view.machine.get('cpu_model', 'an unnamed CPU')}"
    disturbance = disturbance_of(timed_runs(view))
    return f"{said}, {verdict_text(disturbance)}" if disturbance.seconds > 0 else said


def _lines(
    compared: list[Compared], shared: list[Shared], figures: list[Answer], pairs: Pairs
) -> list[str]:
    lines = [f"{plural(len(pairs.pairs), 'cell')} compared"]
    verdicts = Counter(c.assessment.verdict for c in compared)
    if compared:
        lines.append("step times: " + ", ".join(f"{n} {v}" for v, n in verdicts.most_common()))
    lines += [shared_line(one) for one in shared]
    changes = Counter(answer.change for answer in figures)
    if figures:
        words = {"not comparable": STOPPED}
        counts = ", ".join(
            f"{n} {words.get(change, change)}" for change, n in changes.most_common()
        )
        lines.append(f"figures of accuracy and control: {counts}")
    for what, cells in (
        ("only in A", pairs.only_a),
        ("only in B", pairs.only_b),
        ("another problem under the same name", pairs.changed),
        ("lost by the harness", pairs.lost),
    ):
        if cells:
            unlisted = f" and {len(cells) - LISTED} more" if len(cells) > LISTED else ""
            lines.append(f"{what}, not compared: {'; '.join(cells[:LISTED])}{unlisted}")
    return lines

"""Comparison of two result folders: step times, accuracy and control, in lines and tables."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import pandas as pd

from dpbench.analysis.compare.evidence import Assessment
from dpbench.analysis.compare.pairs import (
    ORDER,
    FigureChange,
    Pairs,
    Range,
    compare_accuracy_and_control,
    list_machine_differences,
    pair_runs_of_folders,
)
from dpbench.analysis.compare.times import (
    ComparedTimes,
    SharedFactor,
    Timing,
    choose_reference_solver,
    compare_times_and_shared_factors,
    compare_times_to_reference,
    compute_log_time_ratios,
    explain_unjudged_sequences,
    find_reference_indices,
)
from dpbench.analysis.compare.verdicts import VerdictChange, find_verdict_changes
from dpbench.analysis.records.records import Records
from dpbench.analysis.times.paired_times import MACHINE_DISTURBED
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.bench.record.result_folder import load_results
from dpbench.display import make_html_table
from dpbench.errors import InputError, require_type
from dpbench.report.compare.folders import (
    describe_changed_options,
    describe_code_difference,
    describe_folder,
)
from dpbench.report.compare.further_tables import (
    make_settings_table,
    make_verdicts_table,
    make_windows_table,
)
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_error,
    format_interval,
    format_microseconds,
    format_share,
    format_table_as_html,
    join_with_and,
    make_markdown_document,
    plural,
    significant,
)
from dpbench.report.ship.ship_text import summarise_ships

TIMES = (
    *("slower", "faster", "faster, not all verified"),
    *("no difference shown", "machine disturbed", "equivalent", "not judged"),
)
"""Verdicts on a step time: the two claims, then the weaker ones."""


CHANGES = ("worse", "better", "same", "not comparable")
STOPPED = "not comparable (stopped by a time limit)"


def make_solvers_table(compared: Sequence[ComparedTimes], answers: Sequence[FigureChange]) -> Table:
    """Return a table of whether each solver became slower, faster, worse or better from A to B."""
    names = [c.timing.pair.a.solver for c in compared] + [a.pair.a.solver for a in answers]
    rows = []
    for solver in sorted(set(names)):
        own = [c for c in compared if c.timing.pair.a.solver == solver]
        times = Counter[str](c.assessment.verdict for c in own)
        changes = Counter[str](a.change for a in answers if a.pair.a.solver == solver)
        counts = ", ".join(f"{times[v]} {v}" for v in TIMES if times[v]) or MISSING
        rows.append(
            {
                "solver": solver,
                "step times": _merge_verdicts(times, TIMES),
                "accuracy and control": _merge_verdicts(changes, CHANGES),
                "configurations": counts,
                "metrics": format_count(changes.total()),
            }
        )
    note = (
        "A solver is slower, faster, worse or better if at least one of its configurations is and "
        "none is the opposite. It is equivalent if all its configurations are, and the same if all "
        "comparable metrics are. The error probability of the step time verdicts (--alpha) is "
        "family-wise, over all solvers."
    )
    return Table.from_rows(rows, "Verdict per solver", note=note, text_columns=4)


def _merge_verdicts(counts: Counter[str], order: tuple[str, ...]) -> str:
    """Return one verdict text that sums up counts of verdicts on a solver's configurations."""
    claims = [verdict for verdict in order[:2] if counts[verdict]]
    if len(claims) == 2:
        return f"{claims[0]} and {claims[1]}"
    return next((verdict for verdict in order if counts[verdict]), MISSING)


def make_times_table(
    compared: Sequence[ComparedTimes],
    margin: float,
    alpha: float,
    *,
    ordered: bool = False,
    reference: str = "",
) -> Table:
    """Return a table of step times in runs A and B, their ratio and the verdict on it."""
    machine = f"that ratio of {reference}, the reference"
    if not reference:
        machine = (
            "the median of that ratio over the other configurations of the sequence (with fewer "
            "than four, the ratio that the reference kernel and the calibration workload predict, "
            "if both runs were quiet). If the calibration workload changed more around one "
            "configuration than around the others, half of this excess is included"
        )
    rows = (
        compared if ordered else sorted(compared, key=lambda c: TIMES.index(c.assessment.verdict))
    )
    percent = f"{100 * margin:g} %"
    note = (
        f"B/A: {_describe_measure(compared)}. Machine: {machine}. B/A without machine: B/A "
        "divided by that. The interval holds for all rows together and includes the noise between "
        "two runs. "
        f"Slower or faster: by more than {percent}. Faster, not all verified: the referee does not "
        f"verify every solution of B. Equivalent: within {percent}. Each kind of claim has a "
        f"family-wise error of {100 * alpha:g} % (Holm)."
    )
    cells = [
        {
            "configuration": timing.pair.configuration_label,
            "sequence": timing.pair.a.problem,
            "A p50 [µs]": format_microseconds(timing.median_ns[0]),
            "B p50 [µs]": format_microseconds(timing.median_ns[1]),
            "B/A": f"{found.raw:.3f}",
            "machine": _format_known_factor(found.machine, found),
            "B/A without machine": _format_known_factor(found.ratio.value, found),
            "interval": format_interval(found.ratio.low, found.ratio.high),
            "steps × rounds": f"{format_count(timing.steps)} × {format_count(timing.rounds)}",
            "verdict": found.verdict,
        }
        for timing, found in ((row.timing, row.assessment) for row in rows)
    ]
    return Table.from_rows(cells, "Step times, replays", note=note, text_columns=2)


def _describe_measure(compared: Sequence[ComparedTimes]) -> str:
    """Return a text on what the ratio B/A of step times is computed from."""
    if any(len(one.timing.k) for one in compared):
        return (
            "geometric mean over the steps of the ratio of algorithmic times (minimum over equally "
            "many rounds of both runs)"
        )
    return (
        "ratio of the medians over the steps of algorithmic times (minimum over all rounds of each "
        "run), because a folder has no steps.parquet"
    )


def _format_known_factor(factor: float, found: Assessment) -> str:
    """Format a factor that depends on the machine's; a dash where nothing tells that one."""
    return MISSING if found.verdict == "not judged" else f"{factor:.3f}"


def describe_shared_factor(shared: SharedFactor) -> str:
    """Return a sentence on the step time ratios of a QP sequence, and what the median shows."""
    count = plural(shared.configurations, "configuration")
    wording = f"`{shared.sequence}`: time ratio B/A {shared.factor:.3f} (median of {count})"
    if not math.isnan(shared.kernel):
        wording += f", {shared.kernel:.3f} (reference kernel)"
    if not math.isnan(shared.load):
        wording += f", {shared.load:.3f} (calibration workload)"
    if shared.assessment is None:
        return f"{wording}: not judged, as {shared.unjudged}"
    verdict = shared.assessment.verdict
    cause = " in a part that all configurations share" if verdict in ("slower", "faster") else ""
    return f"{wording}: {verdict}{cause}"


def make_changes_table(answers: Sequence[FigureChange], margin: float) -> Table | None:
    """Return a table of accuracy and control quantities that changed from A to B; None if none."""
    changed = [answer for answer in answers if answer.change in ("worse", "better")]
    if not changed:
        return None
    changed.sort(key=lambda answer: answer.change != "worse")
    unlike = sum(answer.change == "not comparable" for answer in answers)
    left_out = f" {plural(unlike, 'metric')} {STOPPED}." if unlike else ""
    note = (
        f"{plural(len(changed), 'metric')} of {format_count(len(answers) - unlike)}; the others "
        f"are the same within {100 * margin:g} %, counts and shares exactly. A range is "
        f"that of the rounds.{left_out}"
    )
    rows = [
        {
            "configuration": answer.pair.configuration_label,
            "experiment": f"{answer.pair.a.mode.replace('_', ' ')} of {answer.pair.a.problem}",
            "metric": answer.measure.head,
            "A": _format_range(answer.measure.column, answer.a),
            "B": _format_range(answer.measure.column, answer.b),
            "change": answer.change,
        }
        for answer in changed
    ]
    return Table.from_rows(rows, "Accuracy and control: what changed", note=note, text_columns=3)


def describe_change(answer: FigureChange) -> str:
    """Return one line on an accuracy or control quantity in both runs."""
    column = answer.measure.column
    values = " → ".join(_format_range(column, values) for values in (answer.a, answer.b))
    pair = answer.pair
    return f"{answer.measure.head} of {pair.configuration_label} in {pair.a.problem}, {values}"


def _format_range(column: str, values: Range) -> str:
    """Format the range of an accuracy or control quantity; one value if both ends print alike."""
    texts = [_format_quantity(column, value) for value in values]
    return texts[0] if texts[0] == texts[1] else f"{texts[0]} … {texts[1]}"


def _format_quantity(column: str, value: float) -> str:
    """Format a compared quantity by its column: outcome, error, share or count."""
    if column == "outcome":
        return ORDER[int(value)].replace("_", " ")
    if column.startswith("error"):
        return format_error(value)
    if column.endswith("share"):
        return format_share(value)
    if column in ("failed_steps", "steps_done"):
        return format_count(value)
    return significant(value, 4)


def describe_changes_in_si_units(answers: Sequence[FigureChange]) -> list[str]:
    """Return a line that counts the changed metrics of runs in SI units; none without any."""
    changes = Counter(a.change for a in answers if a.pair.a.units == "si")
    counts = [f"{format_count(n)} {name}" for name in ("worse", "better") if (n := changes[name])]
    if not counts:
        return []
    return [
        f"in SI units: {', '.join(counts)} (such runs show the effect of scaling and "
        "count towards no solver's verdict)"
    ]


LISTED = 5


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of two result folders: verdicts on times, accuracy and control.

    Parameters
    ----------
    shared : changes that all configurations of a sequence share.
    figures : every figure of accuracy and control; lines : the verdict in a few lines of text.
    margin : ratio that counts as equal; alpha : family-wise error of the claims.
    reference : solver that step times are divided by, "" for none.
    verdict_changes : configurations whose verdict differs between the folders.

    Examples
    --------
    >>> compare("results/smoke", "results/smoke").worse
    False
    """

    compared: list[ComparedTimes]
    shared: list[SharedFactor]
    figures: list[FigureChange]
    pairs: Pairs
    lines: list[str]
    tables: list[Table]
    margin: float = 0.05
    alpha: float = 0.05
    reference: str = ""
    verdict_changes: Sequence[VerdictChange] = ()

    def __repr__(self) -> str:
        verdict = "a regression" if self.worse else "no regression"
        return f"<Comparison of {plural(len(self.pairs.pairs), 'cell')}: {verdict} shown>"

    def _repr_html_(self) -> str:
        """Return the comparison as HTML, which a notebook displays."""
        lines = make_html_table((), [(line,) for line in self.lines], title="Comparison")
        return lines + "".join(format_table_as_html(table) for table in self.tables)

    @property
    def worse(self) -> bool:
        """True if a regression is shown: slower, less accurate, or worse control.

        Examples
        --------
        >>> compare("results/smoke", "results/smoke").worse
        False
        """
        together = [s.assessment for s in self.shared if s.assessment is not None]
        slow = any(
            j.verdict == "slower" for j in [*(c.assessment for c in self.compared), *together]
        )
        return slow or any(answer.change == "worse" for answer in self.figures)

    @property
    def times(self) -> pd.DataFrame:
        """Table of step time ratios: a row per configuration and sequence.

        Examples
        --------
        >>> compare("results/smoke", "results/smoke").times["raw"].unique().tolist()
        [1.0]
        """
        return pd.DataFrame([compared.table_row for compared in self.compared])

    @property
    def answers(self) -> pd.DataFrame:
        """Table of accuracy and control: a row per configuration and compared quantity.

        Examples
        --------
        >>> compare("results/smoke", "results/smoke").answers["change"].unique().tolist()
        ['same']
        """
        return pd.DataFrame([answer.table_row for answer in self.figures])

    @property
    def headline(self) -> str:
        """Verdict of the comparison in a few words, what is worse first.

        Examples
        --------
        >>> compare("results/smoke", "results/smoke").headline  # doctest: +ELLIPSIS
        'no difference shown...'
        """
        times = {one.assessment.verdict for one in self.compared}
        count = len(self.verdict_changes)
        verdicts = [f"{plural(count, 'verdict')} changed"] if count else []
        if worse := [figure for figure in self.figures if figure.change == "worse"]:
            where = "" if list_metrics_in_verdicts(worse) else " in SI units"
            slower = ", slower" if "slower" in times else ""
            return ", ".join([f"worse accuracy or control{where}{slower}", *verdicts])
        if self.worse:
            return ", ".join(["slower", *verdicts])
        is_better = any(figure.change == "better" for figure in self.figures)
        changed = ["better accuracy or control"] * is_better + ["faster"] * ("faster" in times)
        changed += verdicts
        machine = "on a disturbed machine" * self.is_disturbed
        if self.note_on_times == "times not judged":
            unjudged = " ".join(filter(None, (self.note_on_times, machine)))
            return f"{unjudged}; {', '.join(changed) or 'no other difference'}"
        shown = [*(changed or ["no difference shown"]), self.note_on_times, machine]
        return ", ".join(filter(None, shown))

    @property
    def is_disturbed(self) -> bool:
        """True if other load prevented a verdict on step times.

        Examples
        --------
        >>> isinstance(compare("results/smoke", "results/smoke").is_disturbed, bool)
        True
        """
        verdicts = {one.assessment.verdict for one in self.compared}
        return MACHINE_DISTURBED in verdicts or any("disturbed" in s.unjudged for s in self.shared)

    @property
    def reason_without_verdict(self) -> str:
        """Reason for a step time without a verdict: other load, or no measure of the machine.

        Examples
        --------
        >>> isinstance(compare("results/smoke", "results/smoke").reason_without_verdict, str)
        True
        """
        if self.is_disturbed:
            return "disturbed"
        is_judged = all(one.assessment.verdict != "not judged" for one in self.compared)
        return "" if is_judged else "times not judged"

    @property
    def note_on_times(self) -> str:
        """Reason for a verdict on accuracy: no times compared, or none judged; "" elsewhere.

        Examples
        --------
        >>> compare("results/smoke", "results/smoke").note_on_times
        ''
        """
        if not self.compared:
            return "accuracy only"
        judged = any(one.assessment.verdict != "not judged" for one in self.compared)
        return "" if judged else "times not judged"

    def markdown(self) -> str:
        """Return the comparison of two result folders as a Markdown document.

        Examples
        --------
        >>> text = compare("results/smoke", "results/smoke").markdown()
        >>> text.startswith("# Comparison: no difference shown")
        True
        """
        return make_markdown_document(f"Comparison: {self.headline}", self.lines, self.tables)


def compare(
    a: str | Path,
    b: str | Path,
    *,
    reference: str | None = None,
    margin: float = 0.05,
    alpha: float = 0.05,
) -> Comparison:
    """Return the comparison of result folder B with A: step times, accuracy and control.

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

    Examples
    --------
    >>> comparison = compare("results/smoke", "results/smoke", margin=0.1)
    >>> {figure.change for figure in comparison.figures}
    {'same'}
    """
    require_type("reference", reference, str | None, "the name of a solver")
    require_type("margin", margin, Real, "a number above 0, such as 0.05 for 5 %")
    require_type("alpha", alpha, Real, "a number above 0 and below 0.5")
    if not (margin > 0.0 and math.isfinite(margin)):
        raise InputError("`margin`", "", margin, "a finite number above 0, such as 0.05 for 5 %")
    if not 0.0 < alpha < 0.5:
        raise InputError("`alpha`", "", alpha, "a number above 0 and below 0.5")
    results = load_results(a, without_steps=True), load_results(b, without_steps=True)
    views = Records(results[0]), Records(results[1])
    pairs = pair_runs_of_folders(*views, names=(str(a), str(b)))
    differ = list_machine_differences(results[0].machine, results[1].machine)
    timings = compute_log_time_ratios(*views, pairs.pairs)
    solver = choose_reference_solver(timings, reference) if differ or reference else ""
    compared, shared, wording = _compare_times(views, timings, solver, margin, alpha)
    figures = compare_accuracy_and_control(*views, pairs.pairs, margin)
    verdicts = find_verdict_changes(*views, pairs)
    warnings = [summarise_ships(find_ship_results(view)).warning for view in views]
    lines = [*_describe_verdict_changes(verdicts), *_describe_worse(figures)]
    lines += [f"{name}: {text}" for name, text in zip("AB", warnings, strict=True) if text]
    lines += [f"A: {describe_folder(str(a), views[0])}", f"B: {describe_folder(str(b), views[1])}"]
    lines += filter(None, [describe_code_difference(*views)])
    lines += [f"another machine: they differ in {join_with_and(differ)}"] if differ else []
    lines += [*wording, *_make_summary_lines(compared, shared, figures, pairs)]
    changed = make_changes_table(figures, margin)
    tables = [make_solvers_table(compared, figures)] if compared or figures else []
    tables += [make_times_table(compared, margin, alpha, reference=solver)] if compared else []
    further = (
        make_verdicts_table(*views, verdicts),
        make_windows_table(*views, pairs.pairs),
        changed,
        make_settings_table(*views),
    )
    tables += [table for table in further if table is not None]
    return Comparison(
        compared, shared, figures, pairs, lines, tables, margin, alpha, solver, verdicts
    )


def _compare_times(
    views: tuple[Records, Records], timings: list[Timing], solver: str, margin: float, alpha: float
) -> tuple[list[ComparedTimes], list[SharedFactor], list[str]]:
    """Return verdicts on step time ratios between two folders, shared changes and remarks."""
    wording = []
    bare = [name for name, view in zip("AB", views, strict=True) if not view.has_steps]
    if bare and timings:
        uncounted = ", failed steps and" if len(bare) == 1 else ","
        wording.append(
            f"no steps.parquet in {join_with_and(bare)}: medians of step times are compared"
            f"{uncounted} verdicts are not"
        )
    if not solver:
        unjudged = explain_unjudged_sequences(*views, timings)
        return *compare_times_and_shared_factors(timings, margin, alpha, unjudged), wording
    rows = find_reference_indices(timings, solver)
    known = [timings[row] for row in dict.fromkeys(rows.tolist()) if row >= 0]
    took = [f"{math.exp(one.log):.3g} on {one.pair.a.problem}" for one in known]
    wording.append(
        f"step times are compared as ratios to {known[0].pair.configuration_label}, "
        f"whose B/A is {join_with_and(took)}"
    )
    return compare_times_to_reference(timings, margin, alpha, rows), [], wording


def _make_summary_lines(
    compared: list[ComparedTimes],
    shared: list[SharedFactor],
    figures: list[FigureChange],
    pairs: Pairs,
) -> list[str]:
    """Return lines that sum up a comparison: cells, step times, answers and unpaired runs."""
    lines = [f"{plural(len(pairs.pairs), 'cell')} compared", *describe_changed_options(pairs)]
    verdicts = Counter(c.assessment.verdict for c in compared)
    if compared:
        lines.append(
            "step times: " + ", ".join(f"{format_count(n)} {v}" for v, n in verdicts.most_common())
        )
    windows = sum(pair.a.steps_searched_for_hardest > 0 for pair in pairs.pairs)
    if windows:
        lines.append(f"{plural(windows, 'window')}: step times without a verdict")
    lines += [describe_shared_factor(one) for one in shared]
    changes = Counter(answer.change for answer in figures)
    if figures:
        words = {"not comparable": STOPPED}
        counts = ", ".join(
            f"{format_count(n)} {words.get(change, change)}" for change, n in changes.most_common()
        )
        lines.append(f"accuracy and control: {counts}")
        lines += [f"of these {line}" for line in describe_changes_in_si_units(figures)]
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


def _describe_verdict_changes(changes: Sequence[VerdictChange]) -> list[str]:
    """Return a line that counts changed verdicts by kind; none where no verdict changed."""
    kinds = Counter(f"{change.a.state} → {change.b.state}" for change in changes)
    counts = ", ".join(f"{n} {kind}" for kind, n in kinds.items())
    return [f"verdicts changed: {counts}"] if changes else []


def list_metrics_in_verdicts(figures: Sequence[FigureChange]) -> list[FigureChange]:
    """Return the metrics of runs in scaled units, which count towards verdicts of solvers."""
    return [figure for figure in figures if figure.pair.a.units != "si"]


def _describe_worse(figures: Sequence[FigureChange]) -> list[str]:
    """Return a line that counts the metrics that are worse and gives the first; or none."""
    worse = [f for f in list_metrics_in_verdicts(figures) if f.change == "worse"]
    if not worse:
        return []
    return [f"worse: {plural(len(worse), 'metric')}, first {describe_change(worse[0])}"]

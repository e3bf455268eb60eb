"""Comparison of two revisions by runs of pytest-benchmark on one machine, with its verdicts.

A run of each is one block; several alternating runs are pairs of blocks, whose scatter is the noise
between runs. A time is a benchmark's minimum, in units of the reference kernel where both runs have
timed that beside the benchmark. It is worse where the ratio of the two revisions, without the
factor that the benchmarks of other solvers share, is beyond the margin by more than the ratios
scatter. While the machine was disturbed no time has a verdict but that of a gross slowdown. Exact
measures (`extra_info["exact"]`: iterations, instructions, error, rows, peak bytes) are worse where
they grow.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from shlex import quote

import numpy as np
from rich.console import Console
from rich.table import Table as ScreenTable
from rich.text import Text

from dpbench.analysis.compare.evidence import (
    Assessment,
    Prior,
    assess_time_ratios,
    remove_factor_shared_by_group,
)
from dpbench.analysis.records.machine import GROSS
from dpbench.analysis.statistics import Interval
from dpbench.ci import MARGIN, Allowance
from dpbench.ci.benchmarks import WRONG_ANSWERS, Benchmark, BenchmarkRun
from dpbench.ci.gross_slowdown import find_unmet_condition
from dpbench.report.formats import (
    Table,
    escape_markdown_paragraph,
    format_count,
    join_with_and,
    make_markdown_table,
    plural,
    significant,
)

NOT_TIMED, SLOWER, WORSE, GONE = "failed, not timed", "slower", "worse", "gone"
GROSSLY_SLOWER = "slower, on a disturbed machine"
DISTURBED, NO_KERNEL, NOT_VERIFIED = "disturbed", "no reference kernel", "faster, not all verified"
FASTER, NO_CHANGE, NEW, NO_BASELINE = "faster", "no difference shown", "new", "no baseline"
NOT_RUN = "not run"
REGRESSIONS = (WRONG_ANSWERS, NOT_TIMED, SLOWER, GROSSLY_SLOWER, WORSE, GONE)
"""Verdicts that are a regression, the gravest first."""
ORDER = (
    *REGRESSIONS,
    DISTURBED,
    NO_KERNEL,
    FASTER,
    NOT_VERIFIED,
    NO_CHANGE,
    NEW,
    NO_BASELINE,
    NOT_RUN,
)
"""All verdicts, in the order in which they head a comparison."""
MEANINGS = {
    WRONG_ANSWERS: "answers beyond the requirements of the test",
    NOT_TIMED: "a test failed before it was timed",
    WORSE: "an exact measure grew",
    GONE: "a benchmark of the base is missing or skipped",
    DISTURBED: "times not judged, other load disturbed the machine",
    NO_KERNEL: "times not judged, too few other solvers and no reference kernel: add the fixture "
    "dpbench_reference_kernel to the tests and measure the baseline again",
    NOT_VERIFIED: "a smaller time, but not every answer is verified",
    NEW: "the base has no such benchmark",
    NO_BASELINE: "the base has no benchmark, nothing compared",
    NOT_RUN: "left out by the arguments of pytest",
}
NOT_COMPARED = {
    WRONG_ANSWERS: "with wrong answers",
    NOT_TIMED: "failed",
    GONE: "gone",
    NEW: "new",
    NO_BASELINE: "without baseline",
    NOT_RUN: "not run",
}
"""Words behind the number of benchmarks that only one revision has timed, by verdict."""
NOT_JUDGED = {
    DISTURBED: "machine disturbed",
    NO_KERNEL: "too few other solvers and no reference kernel",
}
"""Reasons why a compared time has no verdict."""
OUTCOMES = {NO_BASELINE: NO_BASELINE, DISTURBED: DISTURBED, NO_KERNEL: "times not judged"}
"""Words for the exit code by verdict, where there is no regression but no full comparison."""
EXACT_JUDGED = (
    "exact measures are judged on a disturbed machine too: iterations, errors, counts in "
    'extra_info["exact"]'
)
"""Remedy where times have no verdict."""
MEASURES = {
    "iterations": ("iterations", "iterations", ""),
    "error_move_max": ("errors", "largest error of the first move", " maximum increments"),
    "peak_bytes": ("memory", "peak memory", " bytes"),
}
"""Exact measures by name: kind, words and unit. Others are shown by their name."""
ALPHA = 0.05
NOISE = Prior(sd=0.05, df=6.0)
"""Noise of one benchmark in its few rounds, between two runs of the same code."""
LAYOUT_SD = 0.02
"""Part of NOISE that pairs of runs do not average: memory layout and paths of the two trees."""
SLACK = {"peak_bytes": (1.1, 128.0), "error_move_max": (1.1, 1e-9)}
"""Factor and number by which an exact measure may grow: when SciPy frees memory is not exact, and
an error below 1e-9 of the maximum increment is rounding."""
FEWEST_PAIRS = 3
"""Undisturbed pairs of runs that suffice, where there are as many pairs."""

Pairs = Sequence[tuple[BenchmarkRun, BenchmarkRun]]
Allowed = Collection[Allowance]


@dataclass(frozen=True)
class Row:
    """Verdict on one benchmark, ratio of its times with interval, and what explains it.

    not_judged : DISTURBED or NO_KERNEL where the times have no verdict, "" otherwise.
    disturbed_ratio : ratio of the times that load left without a verdict, NaN for others.
    not_gross : the first unmet condition of a gross slowdown, where there is such a ratio.
    measures : kinds of the exact measures that both revisions have.
    allowed : number of exact measures that grew and may.
    """

    name: str
    verdict: str
    ratio: Interval | None = None
    remarks: tuple[str, ...] = ()
    not_judged: str = ""
    measures: tuple[str, ...] = ()
    disturbed_ratio: float = np.nan
    not_gross: str = ""
    allowed: int = 0

    @property
    def cells(self) -> dict[str, str]:
        """Texts of a benchmark's row in the table of a comparison, by column head."""
        number = "–"
        if self.ratio is not None and np.isfinite(self.ratio.value):
            number = f"{self.ratio.value:.2f}"
            if np.isfinite(self.ratio.high):
                number += f" [{self.ratio.low:.2f}, {self.ratio.high:.2f}]"
        remarks = "; ".join(self.remarks)
        return {
            "benchmark": self.name,
            "verdict": self.verdict,
            "ratio": number,
            "remarks": remarks,
        }


@dataclass(frozen=True)
class RunComparison:
    """Verdicts on all benchmarks of two revisions.

    timed : number of benchmarks whose times were compared.
    counts : number of benchmarks of base and head, those that failed included.
    unused : measures that were allowed to grow, as `iterations:osqp`, and that no benchmark has.
    machine : line on a factor beyond the margin that the other solvers share; "" for none.
    """

    rows: list[Row]
    timed: int
    counts: tuple[int, int]
    allow_gone: bool = False
    unused: tuple[str, ...] = ()
    machine: str = ""

    @property
    def verdict(self) -> str:
        """Gravest verdict of all benchmarks."""
        found = {row.verdict for row in self.rows}
        if self.allow_gone and len(found) > 1:
            found.discard(GONE)
        return next((one for one in ORDER if one in found), NO_BASELINE)

    @property
    def worse(self) -> bool:
        """True if a regression is shown."""
        return self.verdict in REGRESSIONS and not (self.allow_gone and self.verdict == GONE)

    def exit_code(self, disturbed: int) -> int:
        """Return 1 for a regression, else `disturbed` where a time has no verdict, else 0."""
        if self.worse:
            return 1
        return disturbed if self.verdict in NOT_JUDGED else 0

    def describe_scope(self, base: str, head: str) -> str:
        """State in one line how many benchmarks the named base and head have in common."""
        has = [f"{count} in {name}" for name, count in zip((base, head), self.counts, strict=True)]
        counts = Counter(row.verdict for row in self.rows)
        rest = [f"{counts[one]} {word}" for one, word in NOT_COMPARED.items() if counts[one]]
        total = plural(len(self.rows), "benchmark")
        why = f" ({', '.join(rest)})" if rest else ""
        return f"{self.timed} of {total} compared{why}; {', '.join(has)}"

    def describe_verdict(self, base: str) -> str:
        """State whether a regression is shown against the named base, and what is not judged."""
        counts = Counter(row.not_judged for row in self.rows)
        total = plural(len(self.rows), "benchmark")
        times = [
            f"times not judged ({reason}) in {counts[one]} of {total}"
            for one, reason in NOT_JUDGED.items()
            if counts[one]
        ]
        increases = sum(row.allowed for row in self.rows)
        allowed = [f"{plural(increases, 'increase')} allowed"] if increases else []
        if self.verdict == NO_BASELINE:
            return "comparisons start when the base has these benchmarks"
        if self.worse:
            return "; ".join([f"a regression against {base}", *times, *allowed])
        if not times:
            return "; ".join([f"no regression shown against {base}", *allowed])
        order = [kind for kind, _, _ in MEASURES.values()]
        kinds = {kind for row in self.rows for kind in row.measures}
        known = [kind for kind in order if kind in kinds] + sorted(kinds.difference(order))
        exact = f"{join_with_and(known or ['failures'])}: no regression against {base}"
        return "; ".join([*times, exact, *allowed])

    def _describe_bound(self) -> list[str]:
        """Return a line on the largest slowdown that the judged times do not exclude, if any."""
        judged = {row.name: row.ratio for row in self.rows if row.ratio and not row.not_judged}
        if not judged or self.worse:
            return []
        name = max(judged, key=lambda one: judged[one].high)
        return [f"largest slowdown not excluded: × {significant(judged[name].high)} ({name})"]

    @property
    def outcome(self) -> str:
        """Word for the exit code: the regression, or why there is none."""
        return self.verdict if self.worse else OUTCOMES.get(self.verdict, "no regression")

    def describe_exit(self, disturbed: int) -> str:
        """Return the last line: the exit code and its reason."""
        return f"exit code {self.exit_code(disturbed)} ({self.outcome})"

    def describe_unjudged(self, disturbed: int, option: str = "--disturbed-exit") -> list[str]:
        """Return lines on the bound, machine factor, unused allowances, disturbed times, exit code.

        option : the one that selects the exit code.
        """
        lines = self._describe_bound() + ([self.machine] if self.machine else [])
        lines += [f"allowed, but measured in no benchmark: {one}" for one in self.unused]
        unjudged = [row for row in self.rows if np.isfinite(row.disturbed_ratio)]
        if unjudged:
            worst = max(unjudged, key=lambda row: row.disturbed_ratio)
            why = f"; not treated as a gross slowdown (above × {GROSS}): {worst.not_gross}"
            why *= worst.disturbed_ratio > GROSS
            if worst.disturbed_ratio > 1.0:
                ratio = significant(worst.disturbed_ratio)
                lines.append(f"largest ratio not judged: × {ratio} ({worst.name}){why}")
            lines.append(EXACT_JUDGED)
        if self.verdict in NOT_JUDGED and not self.exit_code(disturbed):
            lines.append(f"times not judged give exit code 0; {option} CODE changes it")
        return lines

    @property
    def headline(self) -> str:
        """Verdict, what it means, and how many benchmarks have which verdict."""
        meaning = MEANINGS.get(self.verdict, "")
        counts = Counter(row.verdict for row in self.rows)
        unjudged = sum(bool(row.not_judged) for row in self.rows)
        if self.verdict in NOT_JUDGED and unjudged < self.timed:
            meaning = meaning.replace("times", f"{unjudged} of {self.timed} times", 1)
        text = f"{self.verdict}{f' ({meaning})' if meaning else ''}"
        if len(counts) > 1:
            parts = [f"{counts[one]} {NOT_COMPARED.get(one, one)}" for one in ORDER if counts[one]]
            return f"{text}: {', '.join(parts)}"
        return f"{text}: {plural(len(self.rows), 'benchmark')}"

    @property
    def table(self) -> Table | None:
        """Table with a row for each compared benchmark; None without any."""
        return (
            Table.from_rows([row.cells for row in self.rows], text_columns=4) if self.rows else None
        )

    def markdown(self, lines: Iterable[str] = ()) -> str:
        """Return the comparison as Markdown: verdict, lines on what was compared, table."""
        parts = [f"**dpbench: {escape_markdown_paragraph(self.headline)}**"]
        parts += map(escape_markdown_paragraph, lines)
        if self.table is not None:
            parts.append(make_markdown_table(self.table.heads, self.table.rows, 4))
        return "\n\n".join(parts) + "\n"

    def print(self, console: Console, lines: Iterable[str] = ()) -> None:
        """Print the verdict, a row for each benchmark, and lines below them."""
        console.print(self.headline, markup=False, highlight=False, soft_wrap=True)
        if self.table is not None:
            shown = ScreenTable(show_edge=False, pad_edge=False)
            for head in self.table.heads:
                shown.add_column(head, overflow="fold")
            for row in self.table.rows:
                shown.add_row(*map(Text, row))
            console.print(shown)
        for line in lines:
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def describe_end(
    found: RunComparison,
    base: str,
    head: str,
    disturbed_exit: int = 0,
    option: str = "--disturbed-exit",
) -> list[str]:
    """Return lines on what was compared, whether a regression is shown, and what is not judged."""
    lines = [found.describe_scope(base, head), found.describe_verdict(base)]
    return lines + found.describe_unjudged(disturbed_exit, option)


def compare_runs(
    pairs: Pairs,
    *,
    margin: float = MARGIN,
    allow_gone: bool = False,
    allow: Allowed = (),
    option: str = "--allow",
) -> RunComparison:
    """Return a comparison of two revisions' runs, from (base, head) pairs of alternating runs.

    A benchmark that the head was not to run is not gone.

    allow : exact measures that may grow; option : the one that names them.
    """
    times = _assess_times(pairs, margin)
    was = {name for base, _ in pairs for name in base.names}
    is_timed = any(base.benchmarks for base, _ in pairs)
    failed = {name: why for _, head in pairs for name, why in head.failed.items()}
    failed_before = {name for base, _ in pairs for name in base.failed}
    now = {name for _, head in pairs for name in head.names}
    rows = []
    for name in sorted(was | now):
        if name in failed:
            verdict = WRONG_ANSWERS if failed[name].startswith(WRONG_ANSWERS) else NOT_TIMED
            reason = failed[name].removeprefix(f"{WRONG_ANSWERS}: ")
            too = ("the benchmark fails in the base too",) if name in failed_before else ()
            rows.append(Row(name, verdict, remarks=(reason, *too)))
        elif name not in now:
            is_left_out = all(head.selection.leaves_out(name) for _, head in pairs)
            rows.append(Row(name, NOT_RUN if is_left_out else GONE))
        elif name in times:
            rows.append(_judge_benchmark(name, pairs, *times[name], allow, option))
        else:
            why = [base.failed[name] for base, _ in pairs if name in base.failed][:1]
            rows.append(
                Row(
                    name,
                    NEW if is_timed else NO_BASELINE,
                    remarks=tuple(f"failed in the base: {reason}" for reason in why),
                )
            )
    rows.sort(key=lambda row: ORDER.index(row.verdict))
    unused = tuple(":".join(one[:2]) for one in allow if not _is_measured(one, pairs))
    machine = _describe_machine_factor(times, pairs, margin)
    return RunComparison(rows, len(times), (len(was), len(now)), allow_gone, unused, machine)


def _describe_machine_factor(
    times: dict[str, tuple[Assessment, list[str]]], pairs: Pairs, margin: float
) -> str:
    """Return a line on the factor that other solvers share, beyond the kernel's; "" within it."""
    judged = {name: one.machine for name, (one, complaints) in times.items() if not complaints}
    if not judged:
        return ""
    name = max(judged, key=lambda one: abs(np.log(judged[one])))
    if abs(np.log(judged[name])) <= np.log1p(margin):
        return ""
    factor = f"× {significant(judged[name])}, shared by the benchmarks of all other solvers"
    both = [run.benchmarks[name] for pair in pairs for run in pair if name in run.benchmarks]
    if all(one.reference_ns is not None for one in both):
        return f"factor beyond that of the reference kernel: {factor}: shared code may have changed"
    unknown = "a reference kernel would show whether the machine or shared code has changed"
    return f"machine factor {factor}: {unknown}"


def _is_measured(allowed: Allowance, pairs: Pairs) -> bool:
    """Return whether a benchmark of the base has a measure that may grow, of its solver."""
    measured = (one for base, _ in pairs for one in base.benchmarks.values())
    return any(_is_allowed(name, one, one, [allowed]) for one in measured for name in one.exact)


def _is_allowed(measure: str, was: Benchmark, now: Benchmark, allow: Allowed) -> bool:
    """Return whether a measure of a benchmark may grow so far, by its kind or its own name."""
    names = (measure, MEASURES.get(measure, (measure,))[0])
    own = was.name_in_allowance
    limits = [one.largest for one in allow if one.measure in names and one.solver == own]
    # 1.13 times 100 is less than 113 in floating point.
    bounds = [(1.0 + limit) * (1.0 + 1e-9) * was.exact[measure] for limit in limits]
    # Without a limit the bound of a measure of 0 is NaN.
    return any(not now.exact[measure] > bound for bound in bounds)


def _judge_benchmark(
    name: str,
    pairs: Pairs,
    time: Assessment,
    complaints: Sequence[str],
    allow: Allowed,
    option: str,
) -> Row:
    """Judge a benchmark that both revisions have timed; complaints take its time's verdict."""
    both = [
        (base.benchmarks[name], head.benchmarks[name])
        for base, head in pairs
        if name in base.benchmarks and name in head.benchmarks
    ]
    # What is exact may still have noise of memory: the pair that grew least counts.
    exact = min((find_exact_changes(*pair, allow, option) for pair in both), key=len)
    allowed = min((find_allowed_changes(*pair, allow) for pair in both), key=len)
    ratio: Interval | None = time.ratio
    verdict, remarks, not_judged, not_gross = NO_CHANGE, [*exact, *allowed], "", ""
    if complaints:
        remarks += complaints
        not_gross = find_unmet_condition(both, time.ratio)
        not_judged = DISTURBED if not_gross else ""
        verdict = not_judged or GROSSLY_SLOWER
        if not_gross and all(any(one.complaints for one in pair) for pair in both):
            # Without one quiet pair they show nothing of the noise that load makes.
            ratio = None
    elif not np.isfinite(time.ratio.high):
        verdict = not_judged = NO_KERNEL
    elif time.verdict == "slower":
        verdict = SLOWER
    elif time.verdict == "faster":
        verdict = FASTER if all(head.is_verified for _, head in both) else NOT_VERIFIED
    if exact and verdict not in (SLOWER, GROSSLY_SLOWER):
        verdict = WORSE
    common = {name for was, now in both for name in was.exact.keys() & now.exact.keys()}
    kinds = tuple(MEASURES.get(one, (one,))[0] for one in common)
    disturbed_ratio = time.ratio.value if not_gross else np.nan
    row = Row(name, verdict, ratio, tuple(remarks), not_judged, kinds, disturbed_ratio, not_gross)
    return replace(row, allowed=len(allowed))


def find_exact_changes(
    was: Benchmark, now: Benchmark, allow: Allowed = (), option: str = "--allow"
) -> list[str]:
    """Return lines on the exact measures of one benchmark that grew or are missing.

    allow : measures that may grow, which are left out; option : the one that names them.
    """
    grown = _yield_grown_measures(was, now)
    changes = [
        line + _suggest_allowance(name, was, now, option)
        for name, line in grown
        if not _is_allowed(name, was, now, allow)
    ]
    missing = sorted(was.exact.keys() - now.exact.keys())
    words_of = [MEASURES.get(name, ("", name, ""))[1] for name in missing]
    return changes + [f"{words}: no longer measured" for words in words_of]


def _suggest_allowance(measure: str, was: Benchmark, now: Benchmark, option: str) -> str:
    """Return the option that accepts the growth of a user's own measure; "" for others."""
    if measure in MEASURES:
        return ""
    before, after = was.exact[measure], now.exact[measure]
    limit = f"={np.ceil(100.0 * (after - before) / before):.0f}%" if before > 0.0 else ""
    return f" (to accept: {option} {quote(f'{measure}:{was.name_in_allowance}{limit}')})"


def find_allowed_changes(was: Benchmark, now: Benchmark, allow: Allowed) -> list[str]:
    """Return lines on the exact measures of one benchmark that grew and may."""
    grown = _yield_grown_measures(was, now)
    return [f"{line} (allowed)" for name, line in grown if _is_allowed(name, was, now, allow)]


def _yield_grown_measures(was: Benchmark, now: Benchmark) -> Iterator[tuple[str, str]]:
    """Yield the name of each exact measure that grew, and a line on its values."""
    for name in sorted(was.exact.keys() & now.exact.keys()):
        factor, more = SLACK.get(name, (1.0, 0.0))
        if now.exact[name] > factor * was.exact[name] + more:
            _, words, unit = MEASURES.get(name, ("", name, ""))
            before, after = (_format_measure(one.exact[name]) for one in (was, now))
            yield name, f"{words} {before} → {after}{unit}{_name_worst_step(name, was, now)}"


def _name_worst_step(measure: str, was: Benchmark, now: Benchmark) -> str:
    """Return the step at which an exact measure grew most, as text; "" if it is not known."""
    steps, before, after = (
        list(values.get(name, ()))
        for values, name in ((now.by_step, "k"), (was.by_step, measure), (now.by_step, measure))
    )
    if not after or was.by_step.get("k") != steps:
        return ""
    at = int(np.argmax(np.subtract(after, before)))
    ends = " → ".join(_format_measure(values[at]) for values in (before, after))
    return f" (most at step {steps[at]} of {now.sequence}: {ends})"


def _format_measure(value: float) -> str:
    """Format an exact measure: a count in full, any other number in three significant digits."""
    return format_count(value) if float(value).is_integer() else significant(value)


def _assess_times(pairs: Pairs, margin: float) -> dict[str, tuple[Assessment, list[str]]]:
    """Return by name the assessed time of each benchmark in both revisions, and what disturbed it.

    Disturbed pairs are left out where enough others remain. Below three other solvers the
    reference kernel stands for the machine.
    """
    quiet: dict[str, list[tuple[Benchmark, Benchmark]]] = {}
    loud: dict[str, list[tuple[Benchmark, Benchmark]]] = {}
    for name in sorted({name for _, head in pairs for name in head.benchmarks}):
        both = [
            (base.benchmarks[name], head.benchmarks[name])
            for base, head in pairs
            if name in base.benchmarks and name in head.benchmarks
        ]
        undisturbed = [pair for pair in both if not any(one.complaints for one in pair)]
        if both and len(undisturbed) >= min(FEWEST_PAIRS, len(both)):
            quiet[name] = undisturbed
        elif both:
            loud[name] = both
    found: dict[str, tuple[Assessment, list[str]]] = {
        name: (one, []) for name, one in _assess_ratios_together(quiet, margin).items()
    }
    complaints = {name: _describe_disturbed_runs(both) for name, both in loud.items()}
    loud_found = _assess_ratios_together(loud, margin).items()
    return found | {name: (one, complaints[name]) for name, one in loud_found}


def _describe_disturbed_runs(both: Sequence[tuple[Benchmark, Benchmark]]) -> list[str]:
    """Return remarks on a benchmark's disturbed runs: how many, and the worst."""
    runs = [(side, one) for pair in both for side, one in zip(("base", "head"), pair, strict=True)]
    disturbed = [(side, one) for side, one in runs if one.complaints]
    side, worst = max(disturbed, key=lambda found: len(found[1].complaints))
    count = f"{len(disturbed)} of {plural(len(runs), 'run')} disturbed"
    return [f"{count} ({side}: {', '.join(worst.complaints)})"]


def _assess_ratios_together(
    measured: dict[str, list[tuple[Benchmark, Benchmark]]], margin: float
) -> dict[str, Assessment]:
    """Return by name the assessed time ratio of each benchmark, estimated together from pairs."""
    if not measured:
        return {}
    kernels = np.array(
        [np.mean([_compute_log_kernel_ratio(*p) for p in both]) for both in measured.values()]
    )
    estimates = [_estimate_mean_log_ratio(both) for both in measured.values()]
    logs, own = np.array([one for one, _ in estimates]), np.array([one for _, one in estimates])
    groups = ["plain" if np.isnan(kernel) else "kernel" for kernel in kernels]
    solvers = [both[0][1].solver for both in measured.values()]
    prior = _make_prior_of_mean(min(map(len, measured.values())))
    evidence = remove_factor_shared_by_group(
        logs, own, groups, prior, 0.0 * kernels, subjects=solvers
    )
    return dict(zip(measured, assess_time_ratios(evidence, margin, ALPHA), strict=True))


def _make_prior_of_mean(pairs: int) -> Prior:
    """Return the assumed noise of a mean log ratio over so many pairs of runs."""
    variance = LAYOUT_SD**2 + (NOISE.sd**2 - LAYOUT_SD**2) / pairs
    return Prior(float(np.sqrt(variance)), NOISE.df)


def _estimate_mean_log_ratio(both: Sequence[tuple[Benchmark, Benchmark]]) -> tuple[float, float]:
    """Return the mean log ratio of pairs of runs, less the kernel's, and its standard error."""
    logs = np.array(
        [
            np.log(now.minimum_s / was.minimum_s)
            - np.nan_to_num(_compute_log_kernel_ratio(was, now))
            for was, now in both
        ]
    )
    if len(logs) == 1:
        ((was, now),) = both
        return float(logs[0]), was.error + now.error
    squares, df = float(np.sum((logs - logs.mean()) ** 2)), len(logs) - 1
    moderated = (NOISE.df * NOISE.sd**2 + squares) / (NOISE.df + df)
    # Never smaller than it is found.
    return float(logs.mean()), float(np.sqrt(max(moderated, squares / df) / len(logs)))


def _compute_log_kernel_ratio(was: Benchmark, now: Benchmark) -> float:
    """Return the log ratio of the reference kernel of two runs; NaN where one did not time it."""
    if was.reference_ns is None or now.reference_ns is None:
        return np.nan
    return float(np.log(now.reference_ns / was.reference_ns))

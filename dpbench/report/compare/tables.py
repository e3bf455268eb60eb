"""Tables of a comparison, in the words of the report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from dpbench.analysis.compare.answers import ORDER, Answer, Range
from dpbench.analysis.compare.times import Compared, Shared
from dpbench.report.formats import (
    MISSING,
    count_text,
    error_text,
    interval_text,
    micro_text,
    plural,
    share_text,
    significant,
)
from dpbench.report.table import Table

TIMES = ("slower", "faster", "no difference shown", "equivalent")
"""Verdicts on a step time: the two claims, then what claims less."""


CHANGES = ("worse", "better", "same", "not comparable")
"""Verdicts on a figure of accuracy or control, likewise."""
STOPPED = "not comparable (stopped by a time limit)"


def solvers_table(compared: Sequence[Compared], answers: Sequence[Answer]) -> Table:
    """Return one row per solver: verdicts of all its configurations together."""
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
                "step times": _together(times, TIMES),
                "accuracy and control": _together(changes, CHANGES),
                "configurations": counts,
                "figures": count_text(changes.total()),
            }
        )
    note = (
        "Over all its configurations: slower, faster, worse or better where a configuration is "
        "and none is the contrary; equivalent where every configuration is; same where every "
        "figure that is comparable is. Claims on step times hold together over all solvers."
    )
    return Table.of(rows, "Verdict per solver", note=note, text_columns=4)


def _together(counts: Counter[str], order: tuple[str, ...]) -> str:
    """Merge several verdicts into one; `order`: the two claims, then the weaker ones."""
    claims = [verdict for verdict in order[:2] if counts[verdict]]
    if len(claims) == 2:
        return f"{claims[0]} and {claims[1]}"
    return next((verdict for verdict in order if counts[verdict]), MISSING)


ALL_OTHERS = (
    "the median of that ratio over the other configurations of the sequence (below four of the "
    "reference kernel, if both runs were quiet)"
)


def times_table(
    compared: Sequence[Compared],
    margin: float,
    alpha: float,
    *,
    ordered: bool = False,
    reference: str = "",
) -> Table:
    """Return one row per configuration and sequence, claims first unless they are `ordered`."""
    machine = f"that ratio of {reference}, the reference" if reference else ALL_OTHERS
    rows = (
        compared if ordered else sorted(compared, key=lambda c: TIMES.index(c.assessment.verdict))
    )
    percent = f"{100 * margin:g} %"
    note = (
        "B/A: geometric mean over the steps of the ratio of algorithmic times (minimum over "
        f"as many rounds of either run). Machine: {machine}, taken out of the next. Its "
        "interval holds for all rows together and counts the noise between two runs. Slower or "
        f"faster: by more than {percent}; equivalent: within {percent}; each kind of claim "
        f"with a family-wise error of {100 * alpha:g} % (Holm)."
    )
    return Table.of(list(map(_time_row, rows)), "Step times, replays", note=note, text_columns=2)


def _time_row(compared: Compared) -> dict[str, str]:
    timing, assessment = compared.timing, compared.assessment
    return {
        "configuration": timing.pair.label,
        "sequence": timing.pair.a.problem,
        "A p50 [µs]": micro_text(timing.median_ns[0]),
        "B p50 [µs]": micro_text(timing.median_ns[1]),
        "B/A": f"{assessment.raw:.3f}",
        "machine": f"{assessment.machine:.3f}",
        "B/A less machine": f"{assessment.ratio.value:.3f}",
        "interval": interval_text(assessment.ratio.low, assessment.ratio.high),
        "steps × rounds": f"{count_text(timing.steps)} × {count_text(timing.rounds)}",
        "verdict": assessment.verdict,
    }


def shared_line(shared: Shared) -> str:
    """State the change that all configurations of a sequence share, and its cause."""
    moved = "rose" if shared.factor >= 1.0 else "fell"
    said = f"`{shared.sequence}`: step times of "
    said += f"{plural(shared.configurations, 'configuration')} {moved} together "
    said += f"by a factor {shared.factor:.3f}"
    if not math.isnan(shared.kernel):
        said += f", by {shared.kernel:.3f} the reference kernel"
    if not math.isnan(shared.load):
        said += f", by {shared.load:.3f} the load kernel"
    if shared.assessment is None:
        return f"{said}; {shared.unjudged}, so this is not judged"
    verdict = shared.assessment.verdict
    cause = " in a part that all configurations share" if verdict in ("slower", "faster") else ""
    return f"{said}: {verdict}{cause}"


def answers_table(answers: Sequence[Answer], margin: float) -> Table | None:
    """Return the figures that changed, worse ones first; None where none did."""
    changed = [answer for answer in answers if answer.change in ("worse", "better")]
    if not changed:
        return None
    changed.sort(key=lambda answer: answer.change != "worse")
    unlike = sum(answer.change == "not comparable" for answer in answers)
    left_out = f" {plural(unlike, 'figure')} {STOPPED}." if unlike else ""
    note = (
        f"{plural(len(changed), 'figure')} of {count_text(len(answers) - unlike)}; the others are "
        f"the same within {100 * margin:g} %, counts and shares exactly. A range: over the rounds."
        f"{left_out}"
    )
    rows, title = list(map(_answer_row, changed)), "Accuracy and control: what changed"
    return Table.of(rows, title, note=note, text_columns=3)


def answer_line(answer: Answer) -> str:
    """One figure that changed, in a line."""
    column = answer.measure.column
    values = " → ".join(_range_text(column, values) for values in (answer.a, answer.b))
    return f"{answer.measure.head} of {answer.pair.label} in {answer.pair.a.problem}, {values}"


def _answer_row(answer: Answer) -> dict[str, str]:
    column = answer.measure.column
    return {
        "configuration": answer.pair.label,
        "experiment": f"{answer.pair.a.mode.replace('_', ' ')} of {answer.pair.a.problem}",
        "figure": answer.measure.head,
        "A": _range_text(column, answer.a),
        "B": _range_text(column, answer.b),
        "change": answer.change,
    }


def _range_text(column: str, values: Range) -> str:
    texts = [_figure_text(column, value) for value in values]
    return texts[0] if texts[0] == texts[1] else f"{texts[0]} … {texts[1]}"


def _figure_text(column: str, value: float) -> str:
    if column == "outcome":
        return ORDER[int(value)].replace("_", " ")
    if column.startswith("error"):
        return error_text(value)
    if column.endswith("share"):
        return share_text(value)
    if column in ("failed_steps", "steps_done"):
        return count_text(value)
    return significant(value, 4)

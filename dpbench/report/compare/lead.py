"""What a comparison says first: what became slower, and what worse."""

from __future__ import annotations

from dpbench.analysis.compare.times import Compared
from dpbench.report.compare.comparison import Comparison
from dpbench.report.compare.tables import answer_line, shared_line
from dpbench.report.formats import interval_text, plural


def lead(comparison: Comparison) -> list[str]:
    """One sentence on times and accuracy, then what all configurations became slower by."""
    together = [
        f"All together: {shared_line(shared)}.".replace("`", "")
        for shared in comparison.shared
        if shared.assessment is not None and shared.assessment.verdict == "slower"
    ]
    return [f"{_slower(comparison)} {_worse(comparison)}".replace("`", ""), *together]


def said(one: Compared) -> str:
    """The verdict on one configuration with its figures."""
    found, timing = one.assessment, one.timing
    return (
        f"B takes {found.ratio.value:.3f} times as long as A, the machine's factor "
        f"{found.machine:.3f} taken out (interval "
        f"{interval_text(found.ratio.low, found.ratio.high)}, {plural(timing.steps, 'step')}, "
        f"{plural(timing.rounds, 'round')}): {found.verdict}."
    )


def _slower(comparison: Comparison) -> str:
    slower = [c for c in comparison.compared if c.assessment.verdict == "slower"]
    count = len(comparison.compared)
    if not count:
        return "No step times to compare."
    if not slower:
        return f"None of {plural(count, 'configuration')} is shown to be slower."
    first = max(slower, key=lambda c: c.assessment.ratio.value)
    pair, ratio = first.timing.pair, first.assessment.ratio
    return (
        f"Slower: {len(slower)} of {plural(count, 'configuration')}, most of all {pair.label} on "
        f"{pair.a.problem}, {ratio.value:.2f} times as long (interval "
        f"{interval_text(ratio.low, ratio.high)}, machine factor "
        f"{first.assessment.machine:.2f} taken out)."
    )


def _worse(comparison: Comparison) -> str:
    worse = [answer for answer in comparison.found if answer.change == "worse"]
    count = len(comparison.found)
    if not worse:
        return f"No figure of accuracy or control of {count} is worse." if count else ""
    return f"Worse: {len(worse)} of {plural(count, 'figure')}, first {answer_line(worse[0])}."

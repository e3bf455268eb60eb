"""Two configurations on the same steps: exact cases."""

import math
from typing import Any

import pytest

from dpbench.analysis.times.contrasts import PairedComparison, paired_comparison
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import verdicts_of

EXACT = {"spread": 0.0, "rounds": 1}
"""Every algorithmic time is the median itself."""


def _compared(records: Any) -> PairedComparison:
    view = records.view()
    first, second = verdicts_of(view, Requirements()).references
    return paired_comparison(view, first, second)


def test_sequences_weigh_the_same_in_a_ratio(records: Any) -> None:
    """Twice as long on 1000 steps and 8 times on 500 is 4 times."""
    for solver, factors in (("base", (1.0, 1.0, 1.0)), ("other", (2.0, 8.0, 99.0))):
        for (sequence, steps), factor in zip(
            (("paper", 1000), ("calm", 500), ("rough", 100)), factors, strict=True
        ):
            records.replay(solver, sequence, steps=steps, median_us=10.0 * factor, **EXACT)
    found = _compared(records)
    assert (found.ratio.value, found.steps) == (pytest.approx(4.0), 1500)
    assert (found.ratio.low, found.ratio.high, found.unstable) == (0.0, math.inf, False)


def test_a_ratio_that_turns_with_the_sequence_names_both_leaders(records: Any) -> None:
    for solver, medians in (("base", (20.0, 20.0)), ("other", (10.0, 80.0))):
        for sequence, median_us in zip(("paper", "calm"), medians, strict=True):
            records.replay(solver, sequence, steps=400, median_us=median_us, **EXACT)
    found = _compared(records)
    assert found.leaders["median on `paper`"] == "other (qpsolvers fresh)"
    assert found.leaders["median on `calm`"] == "base (qpsolvers fresh)"
    assert found.unstable


def test_only_common_steps_are_compared(records: Any) -> None:
    records.replay(
        "base", steps=300, median_us=10.0, slow=dict.fromkeys(range(250, 300), 50.0), **EXACT
    )
    records.replay("other", steps=300, done=250, median_us=20.0, **EXACT)
    found = _compared(records)
    assert (found.steps, found.ratio.value) == (250, pytest.approx(2.0))


def test_without_a_common_step_nothing_is_compared(records: Any) -> None:
    records.replay("base", "paper", steps=40)
    records.replay("other", "calm", steps=40)
    assert _compared(records).steps == 0

"""Rankings against scipy, counting by hand and data whose other_ranks are known beforehand."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import gmean

from dpbench.analysis.demand import Demand
from dpbench.analysis.times.pooled import CommonSteps, PooledTimes, common_steps
from dpbench.analysis.times.ranks import (
    LEFT_OUT,
    Choice,
    best_configurations,
    profiles,
    rank,
    scale_of,
    shifted_mean,
    weighted_median,
)
from dpbench.bench.record.configuration import Configuration
from dpbench.bench.record.result_folder import load_results
from dpbench.report.blocks import Picture, Tabular
from dpbench.report.section_ranks import ranks_section
from dpbench.report.tables_ranks import sensitivity_text
from dpbench.report.write import build_page

DEMAND = Demand(deadline_ms=1.0)
POSITIVE = st.floats(1.0, 1e6)


def _configuration(
    solver: str, times: Any, error: Any = 0.0, settings: str = "default"
) -> PooledTimes:
    time = np.asarray(times, dtype=np.float64)
    errors = np.broadcast_to(np.asarray(error, dtype=np.float64), time.shape).copy()
    right = bool((errors <= DEMAND.error_move).all())
    return PooledTimes(
        Configuration(solver, "native", "fresh", settings), time, errors, right, True
    )


def _pool(*configurations: PooledTimes, counts: tuple[int, ...] | None = None) -> CommonSteps:
    counts = (len(configurations[0].time_ns),) if counts is None else counts
    names = tuple("abc"[: len(counts)])
    return CommonSteps(names, np.repeat(np.arange(len(counts)), counts), configurations, 0)


@given(st.lists(st.tuples(POSITIVE, POSITIVE, st.booleans()), min_size=1), POSITIVE, POSITIVE)
def test_shifted_mean_is_the_geometric_mean_of_scipy(
    rows: list[tuple[float, float, bool]], shift: float, penalty: float
) -> None:
    """gmean of the shifted times less the shift, unsolved ones at the penalty or left out."""
    times, weights, solved = (np.array(column) for column in zip(*rows, strict=True))
    weights = weights / weights.sum()
    costs = np.where(solved, times, penalty)
    found = shifted_mean(times, solved, weights, Choice("", penalty, shift))
    assert found == pytest.approx(gmean(costs + shift, weights=weights) - shift, abs=1e-5, rel=1e-9)
    left = shifted_mean(times, solved, weights, Choice("", LEFT_OUT, shift))
    if solved.any():
        expected = gmean(times[solved] + shift, weights=weights[solved]) - shift
        assert left == pytest.approx(expected, abs=1e-5, rel=1e-9)
    else:
        assert math.isinf(left)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(1, 5)), min_size=1))
def test_weighted_median_is_that_of_the_repeated_values(rows: list[tuple[int, int]]) -> None:
    """Integer weights are repetitions; the lower median of those is NumPy's inverted CDF."""
    values, weights = (np.array(column, dtype=np.float64) for column in zip(*rows, strict=True))
    repeated = np.repeat(values, weights.astype(int))
    expected = np.percentile(repeated, 50, method="inverted_cdf")
    assert weighted_median(values, weights) == expected


def test_profiles_counted_by_hand() -> None:
    """Four steps, the last solved by nobody; b is unsolved on the third.

    Ratios of a: 1, 2, 1; of b: 2, 1. Each step weighs a quarter.
    """
    a = _configuration("a", [10.0, 40.0, 30.0, 5.0], [0.0, 0.0, 0.0, 1.0])
    b = _configuration("b", [20.0, 20.0, 1.0, 5.0], [0.0, 0.0, 1.0, math.inf])
    (ra, sa), (rb, sb) = profiles(_pool(a, b), [a, b], 1e-2)
    assert (ra.tolist(), sa.tolist()) == ([1.0, 1.0, 2.0], [0.25, 0.5, 0.75])
    assert (rb.tolist(), sb.tolist()) == ([1.0, 2.0], [0.25, 0.5])


def test_sequences_weigh_the_same_in_a_profile() -> None:
    """a is the fastest on all of a long sequence, b on all of a short one: half and half."""
    a, b = _configuration("a", [1.0] * 8 + [3.0] * 2), _configuration("b", [2.0] * 8 + [1.0] * 2)
    found = profiles(_pool(a, b, counts=(8, 2)), [a, b], 1e-2)
    firsts = [float(share[ratio == 1.0].max()) for ratio, share in found]
    assert firsts == pytest.approx([0.5, 0.5])
    assert [float(share[-1]) for _, share in found] == pytest.approx([1.0, 1.0])


def test_a_looser_accuracy_solves_more() -> None:
    """The same answer is solved at 1e-2 and unsolved at 1e-4."""
    a = _configuration("a", [1.0, 1.0], [1e-3, 1e-6])
    shares = [profiles(_pool(a), [a], level)[0][1][-1] for level in (1e-2, 1e-4)]
    assert shares == pytest.approx([1.0, 0.5])


def _other_ranks(common_steps: CommonSteps) -> dict[str, dict[str, int]]:
    return {
        p.pooled.configuration.solver: p.other_places
        for p in rank(common_steps, 1e-2, DEMAND).ranked
    }


def test_a_rank_that_the_shift_decides_is_marked() -> None:
    """steady takes 35 µs on each step; uneven 1 or 1000 µs, so its geometric mean is 31.6 µs.

    The median of uneven (1 µs) is the shift: the mean of ln(t + 1) is that of 44.7 µs, so steady
    leads; with a shift of 0.1 µs it is that of 33.2 µs and uneven leads. A larger one changes
    nothing.
    """
    pooled = _pool(
        _configuration("steady", [35e3] * 40), _configuration("uneven", [1e3] * 20 + [1e6] * 20)
    )
    assert scale_of(pooled, 1e-2)[0] == 1e3
    assert _other_ranks(pooled) == {"steady": {"shift × 0.1": 2}, "uneven": {"shift × 0.1": 1}}


def test_a_rank_that_the_penalty_decides_is_marked() -> None:
    """failing is twice as fast and leaves one step of ten unsolved, at 1 ms against 10 µs.

    Its geometric mean is 5 µs · 200^(1/10) = 8.5 µs against 10 µs; ten times the penalty makes it
    10.7 µs. Without shift worth speaking of, so the data are scaled by a third, faster
    configuration.
    """
    failing = _configuration("failing", [5e3] * 10, [0.0] * 9 + [1.0])
    pooled = _pool(
        failing, _configuration("steady", [10e3] * 10), _configuration("fast", [10.0] * 10)
    )
    found = _other_ranks(pooled)
    assert found["failing"] == {"penalty × 10": 3}
    assert found["steady"] == {"penalty × 10": 2}
    assert found["fast"] == {}


def test_a_rank_that_one_sequence_decides_is_marked() -> None:
    """a is 10 times as fast on one sequence, b 2 times on the other: a leads but for the first."""
    a, b = _configuration("a", [1e3] * 5 + [2e3] * 50), _configuration("b", [10e3] * 5 + [1e3] * 50)
    found = rank(_pool(a, b, counts=(5, 50)), 1e-2, DEMAND)
    assert [(p.pooled.configuration.solver, p.place) for p in found.ranked] == [
        ("a", 1),
        ("b", 2),
    ]
    assert [p.other_places for p in found.ranked] == [
        {"without `a`": 2},
        {"without `a`": 1},
    ]
    assert sensitivity_text(found.ranked[0]) == "2: without `a`"


def test_a_clear_order_is_stable() -> None:
    """A solver twice as fast on every step is first under every choice; equals share a place."""
    pooled = _pool(*(_configuration(s, [t] * 6) for s, t in (("x", 1e3), ("y", 2e3), ("z", 2e3))))
    assert _other_ranks(pooled) == {"x": {}, "y": {}, "z": {}}
    assert [p.place for p in rank(pooled, 1e-2, DEMAND).ranked] == [1, 2, 2]


def test_the_way_that_solves_most_is_the_one_that_is_ranked() -> None:
    """Settings that are faster but miss the accuracy on a step give way to those that do not."""
    fast = _configuration("osqp", [1e3] * 9, [0.0] * 8 + [1e-3])
    tight = _configuration("osqp", [2e3] * 9, settings="high")
    tighter = _configuration("osqp", [3e3] * 9, settings="mid")
    pooled, choice = _pool(fast, tight, tighter), Choice("", 1e6, 1e3)
    assert [
        configuration.configuration.settings
        for configuration in best_configurations(pooled, 1e-4, choice)
    ] == ["high"]
    assert [
        configuration.configuration.settings
        for configuration in best_configurations(pooled, 1e-2, choice)
    ] == ["default"]


def test_who_solves_nothing_is_not_ranked() -> None:
    """A mean of penalties is no speed; the solver is named beside the table."""
    found = rank(
        _pool(_configuration("a", [1e3] * 3), _configuration("b", [1.0] * 3, 0.5)), 1e-2, DEMAND
    )
    assert ([p.pooled.configuration.solver for p in found.ranked], found.idle) == (
        ["a"],
        ("b",),
    )
    assert found.choice.shift_ns == 1e3


def test_a_pool_holds_what_all_its_configurations_were_asked_for(records: Any) -> None:
    """A configuration on one sequence of two is left out; a lost, wrong or missing step is
    unsolved."""
    for sequence, steps in (("paper", 40), ("rough[900:1400]", 10)):
        records.replay("whole", sequence, steps=steps, error=1e-5)
        records.replay("flawed", sequence, steps=steps, wrong=(2,), lost=(3,), error=1e-5)
        records.replay("early", sequence, steps=steps, done=6, error=1e-5)
        records.refused("absent", "no such policy", "replay", sequence=sequence)
    records.replay("once", steps=40)
    pooled = common_steps(records.view(), DEMAND)
    assert pooled is not None
    assert (
        [configuration.configuration.solver for configuration in pooled.pooled],
        pooled.left_out,
    ) == (
        ["whole", "flawed", "early"],
        1,
    )
    assert np.bincount(pooled.sequence_of).tolist() == [40, 10]
    assert pooled.weights[:40].sum() == pytest.approx(0.5)
    whole, flawed, early = pooled.pooled
    assert (whole.solved(1e-4).all(), whole.solved(1e-6).any()) == (True, False)
    assert np.flatnonzero(~flawed.solved(1e-2)).tolist() == [2, 3, 42, 43]
    assert np.flatnonzero(early.solved(1e-2)).tolist() == [*range(6), *range(40, 46)]
    assert np.isnan(early.time_ns[6])


def test_a_sequence_that_nobody_got_through_is_no_part_of_a_pool(records: Any) -> None:
    """Without it the weights of the others still sum to 1, and no configuration is right on
    everything."""
    for solver in ("a", "b"):
        records.replay(solver, steps=30)
        records.replay(solver, "calm", outcome="crashed", steps_done=0)
    pooled = common_steps(records.view(), DEMAND)
    assert pooled is not None
    assert pooled.sequences == ("paper",)
    assert pooled.weights.sum() == pytest.approx(1.0)
    assert [configuration.right for configuration in pooled.pooled] == [False, False]
    assert len(rank(pooled, 1e-2, DEMAND).ranked) == 2


def test_the_section_says_when_nothing_was_replayed(records: Any) -> None:
    """No replay, no ranking."""
    records.loop("daqp")
    (block,) = ranks_section(records.view(), DEMAND).blocks
    assert getattr(block, "text", "").startswith("Missing: no replay")


@pytest.mark.slow
def test_the_section_stands_in_the_report_with_its_figures(campaign: Path) -> None:
    """The report of a campaign like the standard one ranks at three accuracies."""
    page = build_page(load_results(campaign))
    (section,) = [s for s in page.sections if s.key == "ranks"]
    names = [b.name for b in section.blocks if isinstance(b, Picture)]
    assert names == ["work_precision", "work_precision_native", "performance_profiles"]
    titles = [b.table.title for b in section.blocks if isinstance(b, Tabular)]
    assert sum(title.startswith("Ranks at") for title in titles) == 3
    assert sum(title.startswith("Step times against") for title in titles) == 2

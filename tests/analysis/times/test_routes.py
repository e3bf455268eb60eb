"""Wrapper, kept workspace and warm start: differences between neighbouring rows."""

from typing import Any

import numpy as np
import pytest

from dpbench.analysis.times.contrasts import (
    KEPT,
    NATIVE,
    WARM,
    WRAPPED,
    WRAPPED_WARM,
    Comparison,
    RouteComparison,
    RoutePolicy,
    native_comparisons,
    route_comparisons,
)

CALM = {"spread": 0.05, "steps": 1000}


def _routes(records: Any, solver: str, *medians_us: float | None, **warm: Any) -> None:
    """Replays of qpsolvers fresh, native fresh, native reuse, native warm; None is left out."""
    for (route, policy), median in zip((WRAPPED, NATIVE, KEPT, WARM), medians_us, strict=True):
        more = warm if policy == "warm" else {}
        if median is not None:
            configuration = {"route": route, "policy": policy, "median_us": median}
            records.replay(solver, **CALM, **configuration, **more)


def _ways(records: Any) -> RouteComparison:
    (ways,) = route_comparisons(records.view(), "paper")
    return ways


def _beside(comparison: RouteComparison, route: RoutePolicy) -> Comparison:
    found = comparison.compare(route)
    assert found is not None
    return found


def test_each_step_down_is_a_ratio_to_the_way_above(records: Any) -> None:
    """Wrapper, reuse and warm gain are the ratios between neighbouring ways.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of its value (4 sigma).
    """
    _routes(records, "daqp", 40.0, 20.0, 10.0, 8.0)
    ways = _ways(records)
    gains = [_beside(ways, route).gain.value for route in (NATIVE, KEPT, WARM)]
    assert gains == pytest.approx([2.0, 2.0, 1.25], rel=0.01)


def test_warm_is_compared_with_fresh_where_there_is_no_reuse(records: Any) -> None:
    """A missing neighbour is skipped, and the comparison says which one it was."""
    _routes(records, "scs", 40.0, 20.0, None, 10.0)
    records.refused("scs", "it keeps nothing", "replay", route="native", policy="reuse")
    (ways,) = native_comparisons(route_comparisons(records.view(), "paper"))
    found = _beside(ways, WARM)
    assert found.above == NATIVE
    assert found.gain.value == pytest.approx(2.0, rel=0.01)
    assert np.isnan(ways.median_ns(KEPT))


def test_a_warm_start_that_costs_time_is_a_loss(records: Any) -> None:
    """A gain below 1."""
    _routes(records, "proxqp", 40.0, 20.0, 10.0, 15.0)
    found = _beside(_ways(records), WARM)
    assert 1.0 / found.gain.value == pytest.approx(1.5, rel=0.01)


def test_gain_of_a_warm_start_through_the_wrapper(records: Any) -> None:
    """A warm start that halves the time is a gain of two, one that does nothing is none.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of 2 (4 sigma).
    """
    for solver, warm_us in (("helped", 10.0), ("untouched", 20.0)):
        records.replay(solver, median_us=20.0, spread=0.05)
        records.replay(solver, median_us=warm_us, spread=0.05, policy="warm")
    gains = {
        w.solver: _beside(w, WRAPPED_WARM).gain for w in route_comparisons(records.view(), "paper")
    }
    assert gains["helped"].value == pytest.approx(2.0, rel=0.01)
    assert gains["untouched"].value == pytest.approx(1.0, rel=0.01)


def test_settings_are_compared_level_by_level(records: Any) -> None:
    """Each settings level has its own comparison, and none is beside another level."""
    for settings, median_us in (("default", 10.0), ("high", 30.0)):
        for route, policy in (WRAPPED, NATIVE):
            records.replay(
                "osqp", route=route, policy=policy, settings=settings, median_us=median_us, **CALM
            )
    ways = route_comparisons(records.view(), "paper")
    assert [w.settings for w in ways] == ["default", "high"]
    assert all(_beside(w, NATIVE).gain.value == pytest.approx(1.0, rel=0.01) for w in ways)


def test_records_without_native_configurations_have_nothing_to_compare(records: Any) -> None:
    """A folder of the wrapper alone."""
    records.replay("daqp", steps=100)
    assert native_comparisons(route_comparisons(records.view(), "paper")) == []

"""Wrapper, kept workspace and warm start: differences between neighbouring rows."""

from typing import Any

import pytest

from dpbench.analysis.times.contrasts import (
    KEPT,
    NATIVE,
    WARM,
    WRAPPED,
    WRAPPED_WARM,
    RouteGain,
    RoutePolicy,
    compare_routes,
)

CALM = {"spread": 0.05, "steps": 1000}


def _routes(records: Any, solver: str, *medians_us: float | None, **warm: Any) -> None:
    """Replays of qpsolvers fresh, native fresh, native reuse, native warm; None is left out."""
    for (route, policy), median in zip((WRAPPED, NATIVE, KEPT, WARM), medians_us, strict=True):
        more = warm if policy == "warm" else {}
        if median is not None:
            configuration = {"route": route, "policy": policy, "median_us": median}
            records.replay(solver, **CALM, **configuration, **more)


def _gains(records: Any) -> dict[RoutePolicy, RouteGain]:
    """Return the gains of the only solver, by route and policy."""
    return {gain.route: gain for gain in compare_routes(records.view(), "paper")}


def test_each_step_down_is_a_ratio_to_the_way_above(records: Any) -> None:
    """Wrapper, reuse and warm gain are the ratios between neighbouring ways.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of its value (4 sigma).
    """
    _routes(records, "daqp", 40.0, 20.0, 10.0, 8.0)
    found = _gains(records)
    gains = [found[route].gain.value for route in (NATIVE, KEPT, WARM)]
    assert list(found) == [NATIVE, KEPT, WARM]
    assert gains == pytest.approx([2.0, 2.0, 1.25], rel=0.01)


def test_warm_is_compared_with_fresh_where_there_is_no_reuse(records: Any) -> None:
    _routes(records, "scs", 40.0, 20.0, None, 10.0)
    records.refused("scs", "it keeps nothing", "replay", route="native", policy="reuse")
    gains = _gains(records)
    assert gains[WARM].above == NATIVE
    assert gains[WARM].gain.value == pytest.approx(2.0, rel=0.01)
    assert gains[WARM].median_ns == pytest.approx(10e3, rel=0.05)
    assert KEPT not in gains


def test_gain_of_a_warm_start_through_the_wrapper(records: Any) -> None:
    """A warm start that halves the time is a gain of two, one that does nothing is none.

    The geometric mean of 1000 paired ratios of spread 0.07 is within 1 % of 2 (4 sigma).
    """
    for solver, warm_us in (("helped", 10.0), ("untouched", 20.0)):
        records.replay(solver, median_us=20.0, spread=0.05)
        records.replay(solver, median_us=warm_us, spread=0.05, policy="warm")
        records.replay(solver, median_us=10.0, spread=0.05, route="native")
    gains = {
        gain.solver: gain.gain.value
        for gain in compare_routes(records.view(), "paper")
        if gain.route == WRAPPED_WARM
    }
    assert gains["helped"] == pytest.approx(2.0, rel=0.01)
    assert gains["untouched"] == pytest.approx(1.0, rel=0.01)


def test_settings_are_compared_level_by_level(records: Any) -> None:
    for settings, median_us in (("default", 10.0), ("high", 30.0)):
        for route, policy in (WRAPPED, NATIVE):
            records.replay(
                "osqp", route=route, policy=policy, settings=settings, median_us=median_us, **CALM
            )
    gains = compare_routes(records.view(), "paper")
    assert [(gain.settings, gain.route) for gain in gains] == [
        ("default", NATIVE),
        ("high", NATIVE),
    ]
    assert [gain.gain.value for gain in gains] == pytest.approx([1.0, 1.0], rel=0.01)


def test_records_without_native_configurations_have_nothing_to_compare(records: Any) -> None:
    records.replay("daqp", steps=100)
    records.replay("daqp", steps=100, policy="warm")
    assert compare_routes(records.view(), "paper") == []

"""Settings levels_by_solver against hand-made replays, and the suite that carries them."""

import math
from typing import Any

import pytest

from dpbench.analysis.times.solver_tables import level_points
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import load_suite
from dpbench.solvers.settings import setting_names, settings_matter
from dpbench.solvers.table import record

BOTH = ("paper", "rough[900:1400]")
USUAL = dict.fromkeys(("osqp", "whole", "half"), ("qpsolvers", "fresh"))


def test_a_point_is_the_worst_of_its_sequences(records: Any) -> None:
    """Worst p50 and p99, largest error, of two sequences long enough for a p99."""
    records.replay("osqp", BOTH[0], median_us=10.0, spread=0.0, error=1e-5)
    records.replay("osqp", BOTH[1], median_us=30.0, spread=0.0, error=1e-3, failed=2)
    (point,) = level_points(records.view(), BOTH, USUAL)["osqp"]
    assert (point.p50_ns, point.p99_ns, point.error_move) == (30e3, 30e3, 1e-3)
    assert point.failed == 2


def test_both_times_of_a_point_are_of_the_same_steps(records: Any) -> None:
    """A sequence too short for a p99 gives no p50 either, or that would exceed the p99."""
    records.replay("osqp", BOTH[0], median_us=10.0, spread=0.0, error=1e-5)
    records.replay("osqp", BOTH[1], steps=500, median_us=30.0, spread=0.0, error=1e-3)
    (point,) = level_points(records.view(), BOTH, USUAL)["osqp"]
    assert (point.p50_ns, point.p99_ns, point.error_move) == (10e3, 10e3, 1e-3)
    (short,) = level_points(records.view(), BOTH[1:], USUAL)["osqp"]
    assert short.p50_ns == 30e3 and math.isnan(short.p99_ns)


def test_the_points_have_their_levels_in_order_and_leaves_out_other_ways(records: Any) -> None:
    """Default, low, mid, high on the default route; warm starts are another way."""
    for settings in ("high", "default", "low", "mid"):
        records.replay("osqp", settings=settings)
    records.replay("osqp", settings="mid", policy="warm", median_us=1.0)
    (points,) = level_points(records.view(), BOTH[:1], USUAL).values()
    assert [point.configuration.settings for point in points] == ["default", "low", "mid", "high"]
    assert {point.configuration.policy for point in points} == {"fresh"}


def test_all_points_of_a_solver_are_of_the_way_that_is_asked_for(records: Any) -> None:
    """No other policy or route joins the line, however fast; a solver without a way has none."""
    for policy, us in (("fresh", 20.0), ("warm", 5.0), ("reuse", 8.0)):
        records.replay("osqp", route="native", policy=policy, median_us=us, spread=0.0)
    for policy, us in (("fresh", 30.0), ("warm", 60.0)):
        way = {"route": "native", "policy": policy, "settings": "high"}
        records.replay("osqp", **way, median_us=us, spread=0.0)
    records.replay("osqp", median_us=1.0)
    records.replay("daqp", route="native", policy="warm")
    levels = level_points(records.view(), BOTH[:1], {"osqp": ("native", "warm")})
    found = {
        solver: [(p.configuration.settings, p.p50_ns) for p in points]
        for solver, points in levels.items()
    }
    assert found == {"osqp": [("default", 5e3), ("high", 60e3)]}


def test_a_solver_on_one_sequence_of_two_has_no_point(records: Any) -> None:
    records.replay("whole", BOTH[0])
    records.replay("whole", BOTH[1])
    records.replay("half", BOTH[0])
    assert list(level_points(records.view(), BOTH, USUAL)) == ["whole"]


@pytest.mark.parametrize("sequence", ["paper", "rough"])
def test_the_levels_suite_runs_every_level_of_every_solver(sequence: str) -> None:
    """Each solver whose settings matter is replayed at each of its four levels, long enough for
    a p99; the others run once and stand under all names."""
    _, suite = load_suite("levels")
    levels = ("default", "low", "mid", "high")
    found: dict[str, set[str]] = {}
    for planned in plan(suite):
        cell = planned.cell
        if cell.sequence.partition("[")[0] == sequence:
            assert cell.steps >= 1000
            assert cell.route == record(cell.solver).default_route
            names = (cell.settings, *planned.alias_settings)
            found.setdefault(cell.solver, set()).update(names)
    assert {"daqp", "osqp", "piqp", "quadprog"} <= set(found)
    for solver, names in found.items():
        assert names == set(levels) & set(setting_names(solver))
    assert any(not settings_matter(solver) for solver in found)

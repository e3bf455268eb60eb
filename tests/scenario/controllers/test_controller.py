"""The protocol of controllers: kinds by key, limits over time, a class of its own in a run."""

from typing import get_args

import numpy as np
import pytest

from dpbench.bench.judge.evaluation import METRICS
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.mpc.move_limits import AxisLimit, MoveLimit
from dpbench.mpc.thruster_rows import Limits
from dpbench.scenario.controllers.controller import (
    MetricGroup,
    list_force_limits_by_sample,
    stack_lower_and_upper_limits,
)
from dpbench.scenario.controllers.kinds import ForceController
from dpbench.scenario.scenario import CONTROLLERS, build_scenario_from_documents, load_scenario
from dpbench.scenario.tables.scenario_file import ControllerTable


def test_every_kind_of_the_file_has_a_class() -> None:
    assert set(get_args(ControllerTable.model_fields["kind"].annotation)) == set(CONTROLLERS)


def test_every_group_of_metrics_is_computed() -> None:
    assert set(METRICS) == set(get_args(MetricGroup))


@pytest.mark.parametrize(
    ("changes", "high"),
    [
        ([], [9, 9, 9, 9]),
        ([(0, 5)], [5, 5, 5, 5]),
        ([(1, 5), (3, 2)], [9, 5, 5, 2]),
        ([(2, 5), (2, 4)], [9, 9, 4, 4]),
        ([(7, 5)], [9, 9, 9, 9]),
    ],
)
def test_limits_hold_until_the_next_change(changes: list[tuple[int, int]], high: list[int]) -> None:
    own, *changed = (Limits(np.array([-h]), np.array([h])) for h in (9, *(h for _, h in changes)))
    pairs = tuple(zip((k for k, _ in changes), changed, strict=True))
    limits = list_force_limits_by_sample(own, pairs, 4)
    np.testing.assert_array_equal(stack_lower_and_upper_limits(limits)[1][:, 0], high)
    np.testing.assert_array_equal(stack_lower_and_upper_limits(limits)[0][:, 0], np.negative(high))


class Gentle(ForceController):
    """A controller of forces that moves at a third of the rate."""

    def make_increment_limiter(self) -> MoveLimit:
        return AxisLimit(self.problem.du_max / 3.0)


def test_a_class_of_its_own_steers_a_run(monkeypatch: pytest.MonkeyPatch) -> None:

    def gentle(spec: object) -> ForceController:
        return Gentle(**vars(ForceController.from_specification(spec)))  # type: ignore[arg-type] # vars() has no types

    usual = load_scenario("paper").truncate(8)
    monkeypatch.setitem(CONTROLLERS, "forces", gentle)
    made = build_scenario_from_documents(usual.files).truncate(8)
    assert type(made.controller) is Gentle
    for scenario, share in ((usual, 1.0), (made, 1.0 / 3.0)):
        change = np.diff(solve_loop_exactly(scenario).tau, axis=0, prepend=np.zeros((1, 3)))
        largest = np.abs(change / usual.problem.du_max).max()
        assert largest == pytest.approx(share, rel=1e-9)

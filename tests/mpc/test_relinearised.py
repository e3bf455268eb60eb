"""Re-linearised steps against condensing anew with the exponential of the model at that heading."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.errors import InputError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import Refresh

RELATIVE = 1e-11
"""Of the largest entry: rounding of two constructions that sum in another order."""
UNLIKE = np.array([[1.0, 0.3, 2.0], [0.3, 4.0, 0.0], [2.0, 0.0, 300.0]])
"""A weight that tells north from east, and couples both with heading."""
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "soft": {"amplitude": "soft"},
    "outputs": {"outputs": OutputBounds(0.3, 5.0, 0.2)},
    "soft, round the reference": {"amplitude": "soft", "outputs": OutputBounds(0.3, 5.0)},
}


def close(found: np.ndarray, expected: np.ndarray) -> None:
    """The same infinite entries, and finite ones equal up to `RELATIVE` of the largest."""
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(found[~finite], expected[~finite])
    size = float(np.abs(expected[finite]).max(initial=0.0))
    np.testing.assert_allclose(found[finite], expected[finite], rtol=0, atol=RELATIVE * size)


def point(psi_rad: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, a preview (30, 3) and u_prev of a ship under way at a heading."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([0.05 * rng.normal(size=6), rng.normal(size=2), [psi_rad]])
    preview = x[6:] + 0.1 * np.cumsum(rng.normal(size=(30, 3)), axis=0)
    return x, preview, np.array([2e5, -3e5, 4e6]) * rng.uniform(-1, 1, 3)


@pytest.mark.slow
@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    psi0_rad=st.floats(-4, 4),
    psi_rad=st.floats(-7, 7),
    options=st.sampled_from(list(OPTIONS.values())),
    units=st.sampled_from(["scaled", "si"]),
    unlike=st.booleans(),
)
def test_a_relinearised_step_is_the_step_condensed_anew_at_its_heading(
    psi0_rad: float, psi_rad: float, options: Any, units: Any, unlike: bool, ship: Any
) -> None:
    """At any heading P, A, q, l, u, lb and ub are those of a builder made at that heading, held
    or previewed, with the vessel's limits or others."""
    change = {"Q": UNLIKE} if unlike else {}
    here = replace(ship("supply_mss", psi0_rad=psi0_rad), **change)
    there = replace(ship("supply_mss", psi0_rad=psi_rad), **change)
    builder = RelinearisedQP(here, psi0_rad=psi0_rad, units=units, **options)
    fresh = CondensedQP(there, units=units, penalty=builder.penalty, **options)
    x, preview, u_prev = point(psi_rad)
    limits = Limits(0.4 * here.u_min, 0.5 * here.u_max)
    for y_ref in (preview[0], preview):
        for of_now in (None, limits):
            found = builder.problem(builder.emit(x, y_ref, u_prev, limits=of_now))
            expected = fresh.problem(fresh.emit(x, y_ref, u_prev, limits=of_now))
            for name in ("P", "A", "q", "l", "u", "lb", "ub"):
                close(getattr(found, name), getattr(expected, name))
            assert (found.block, found.moves) == (expected.block, expected.moves)


@pytest.mark.parametrize("psi_rad", [0.0, np.pi / 2, -2.9, 9.0])
def test_a_relinearised_step_agrees_with_the_naive_construction(
    ship: Any, naive: Any, psi_rad: float
) -> None:
    """P and q are those written out from the paper with the model at the heading of the step."""
    change = {"Q": UNLIKE}
    builder = RelinearisedQP(replace(ship("supply_fs99"), **change), psi0_rad=0.0)
    x, preview, u_prev = point(psi_rad)
    step = builder.emit(x, preview, u_prev)
    there = replace(ship("supply_fs99", psi0_rad=psi_rad), **change)
    expected = naive(there, x, preview, u_prev)
    assert step.P is not None
    close(step.P, expected.move[:, None] * expected.E * expected.move)
    close(step.q, expected.move * expected.F_k)


@pytest.mark.parametrize("unlike", [False, True], ids=["round Q", "Q unlike"])
def test_the_cost_matrix_turns_only_with_a_weight_that_tells_north_from_east(
    ship: Any, unlike: bool
) -> None:
    """RᵀQR = Q keeps P to the last bit at all headings, and only a controller that condenses
    anew regardless sends it; any other Q changes it, and every step says so."""
    problem = ship("supply_fs99", N_p=60, N_c=10, robust=True)
    problem = replace(problem, Q=UNLIKE) if unlike else problem
    for always in (True, False):
        builder = RelinearisedQP(problem, psi0_rad=0.0, always=always)
        x, preview, u_prev = point(1.3)
        step = builder.emit(x, preview[0], u_prev)
        sent = always or unlike
        assert step.refresh == (Refresh.VECTORS | Refresh.MATRICES if sent else Refresh.VECTORS)
        assert step.A is None
        same = np.array_equal(builder.problem(step).P, CondensedQP(problem).P)
        assert same is not unlike


def test_a_step_of_output_bounds_brings_its_rows(ship: Any) -> None:
    """Sides fixed in the north-east frame are other rows at another heading, so A comes along."""
    builder = RelinearisedQP(ship("supply_fs99"), psi0_rad=0.0, outputs=OutputBounds(0.3, 5.0))
    x, preview, u_prev = point(0.8)
    step = builder.emit(x, preview[0], u_prev)
    assert step.A is not None
    assert np.abs(step.A - CondensedQP(builder.control, outputs=builder.outputs).A).max() > 0.1


def test_steps_stay_valid_after_the_ship_has_turned(ship: Any) -> None:
    """P, A and the vectors of a step are not written to by later ones."""
    problem = replace(ship("supply_fs99"), Q=UNLIKE)
    builder = RelinearisedQP(problem, psi0_rad=0.0, outputs=OutputBounds(0.3, 5.0))
    x, preview, u_prev = point(0.4)
    step = builder.emit(x, preview, u_prev)
    kept = {name: getattr(step, name).copy() for name in ("P", "A", "q", "l", "u")}
    for psi_rad in (0.5, 2.0):
        builder.emit(point(psi_rad)[0], preview, u_prev)
    for name, then in kept.items():
        np.testing.assert_array_equal(getattr(step, name), then)


@pytest.mark.parametrize(
    ("threshold_deg", "expected"),
    # Headings of the steps below are 0, 0, 3, 5, 9, 9, 3.5, 400 degrees.
    [(0.0, [1, 2, 3, 4, 5, 6, 7, 8]), (4.0, [0, 0, 0, 1, 2, 2, 3, 4])],
)
def test_the_model_follows_the_heading_beyond_a_threshold(
    ship: Any, threshold_deg: float, expected: list[int]
) -> None:
    """Threshold 0 re-linearises each step, another one only when the heading has moved that far
    since; steps between bring vectors of the model that is held."""
    builder = RelinearisedQP(
        ship("supply_fs99"), psi0_rad=0.0, threshold_rad=np.radians(threshold_deg)
    )
    before = 0
    for heading_deg, count in zip([0, 0, 3, 5, 9, 9, 3.5, 400], expected, strict=True):
        x, preview, u_prev = point(np.radians(heading_deg))
        step = builder.emit(x, preview[0], u_prev)
        assert (Refresh.MATRICES in step.refresh) is (count > before)
        fresh = CondensedQP(ship("supply_fs99", psi0_rad=builder.heading_rad))
        close(step.q, fresh.emit(x, preview[0], u_prev).q)
        before = count


def test_constant_cost_and_matrices_are_those_of_the_heading(ship: Any, rollout: Any) -> None:
    """½zᵀPz + qᵀz + J0 is the cost by stepping the model of the step's heading."""
    here = replace(ship("supply_fs99", psi0_rad=0.2), Q=UNLIKE)
    builder = RelinearisedQP(here, psi0_rad=0.2)
    x, preview, u_prev = point(1.9)
    step = builder.emit(x, preview, u_prev)
    there = replace(ship("supply_fs99", psi0_rad=1.9), Q=UNLIKE)
    moves = np.random.default_rng(1).uniform(-1, 1, (5, 3)) * there.du_max
    cost = builder.problem(step).objective(builder.plan(moves)) + builder.constant_cost(x, preview)
    assert cost == pytest.approx(rollout(there, x, preview, moves), rel=1e-11)


def test_a_round_terminal_cost_turns_with_the_ship_and_no_other_is_taken(ship: Any) -> None:
    """With the Riccati cost a step is still the one condensed anew, as long as Q weighs north and
    east alike; else the cost is no trigonometric polynomial and the constructor says so."""
    here = replace(ship("supply_tmr", psi0_rad=0.3), terminal="riccati")
    builder = RelinearisedQP(here, psi0_rad=0.3)
    x, preview, u_prev = point(-2.0)
    found = builder.problem(builder.emit(x, preview, u_prev))
    fresh = CondensedQP(replace(ship("supply_tmr", psi0_rad=-2.0), terminal="riccati"))
    expected = fresh.problem(fresh.emit(x, preview, u_prev))
    for name in ("P", "q"):
        close(getattr(found, name), getattr(expected, name))
    with pytest.raises(InputError, match="terminal cost"):
        RelinearisedQP(replace(here, Q=UNLIKE), psi0_rad=0.3)


def test_a_negative_threshold_is_refused(ship: Any) -> None:
    """A threshold is 0 or more."""
    with pytest.raises(InputError, match="threshold_rad"):
        RelinearisedQP(ship("supply_fs99"), psi0_rad=0.0, threshold_rad=-0.1)

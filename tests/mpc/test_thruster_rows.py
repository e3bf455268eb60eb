"""Polygons of thrusters."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.mpc.thruster_rows import (
    LimitRampDown,
    Limits,
    ThrusterRows,
    build_limit_rows_of_thrusters,
)
from dpbench.ship.thrusters import Thruster, ThrusterSet

T = 2e5


def one_azimuth(**other: object) -> ThrusterSet:
    """An azimuth of 200 kN, a tunnel, and a main propeller with less thrust astern."""
    azimuth = Thruster("stern", "azimuth", -30.0, 0.0, T, 10.0, **other)  # type: ignore[arg-type] # keys of one test each
    tunnel = Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0)
    main = Thruster("main", "main", -40.0, 2.0, 3e5, 20.0, astern=0.4)
    return ThrusterSet((azimuth, tunnel, main))


def inside(rows: ThrusterRows, f: np.ndarray) -> np.ndarray:
    """True for each of the forces f (..., n_f) that satisfies all rows."""
    along = f @ rows.G.T
    return np.asarray(((along <= rows.high + 1e-6) & (along >= rows.low - 1e-6)).all(-1))


@pytest.mark.parametrize("sides", [4, 6, 8, 16, 30])
def test_the_polygon_has_its_corners_on_the_circle_and_one_of_them_ahead(sides: int) -> None:
    rows = build_limit_rows_of_thrusters(one_azimuth(), sides)
    angle = 2 * math.pi * np.arange(sides) / sides
    corner = T * np.column_stack((np.cos(angle), np.sin(angle)))
    side = np.roll(corner, -1, axis=0) - corner
    points = np.random.default_rng(sides).uniform(-1.1 * T, 1.1 * T, (4000, 2))
    to_point = points[:, np.newaxis] - corner
    left = side[:, 0] * to_point[..., 1] - side[:, 1] * to_point[..., 0]
    clear = np.abs(left).min(axis=1) > 1e-3 * T**2 / sides**2
    others = {"pad_width": ((0, 0), (0, 2))}
    found = inside(rows, np.pad(points, **others))
    np.testing.assert_array_equal(found[clear], (left >= 0).all(axis=1)[clear])
    assert np.count_nonzero(clear) > 3000
    assert inside(rows, np.pad(corner, **others)).all()
    assert len(rows.low) == sides // 2 + 2


def test_other_thrusters_have_one_row_each_and_all_limits_are_finite() -> None:
    rows = build_limit_rows_of_thrusters(one_azimuth(), 8)
    np.testing.assert_allclose(rows.low[-2:], [-8e4, -1.2e5])
    np.testing.assert_allclose(rows.high[-2:], [8e4, 3e5])
    assert np.isfinite(rows.low).all() and np.isfinite(rows.high).all()
    low, high, _ = rows.limits_after_loss_of_thrusters({0, 2})
    assert high[4] == 8e4
    f = np.random.default_rng(0).uniform(-1e5, 1e5, (1000, 4))
    f[:200, [0, 1, 3]] = 0.0
    gone = ((f @ rows.G.T <= high) & (f @ rows.G.T >= low)).all(axis=1)
    np.testing.assert_array_equal(gone, ~f[:, [0, 1, 3]].any(axis=1) & (np.abs(f[:, 2]) <= 8e4))


@pytest.mark.parametrize("width_deg", [60.0, 120.0, 180.0])
def test_a_sector_keeps_the_directions_it_allows(width_deg: float) -> None:
    start = math.radians(-30.0)
    end = start + math.radians(width_deg)
    rows = build_limit_rows_of_thrusters(one_azimuth(sector_rad=(start, end)), 16)
    angle, zero = np.linspace(start - 1.0, end + 1.0, 101), np.zeros(101)
    f = 0.5 * T * np.column_stack((np.cos(angle), np.sin(angle), zero, zero))
    within = (angle >= start - 1e-9) & (angle <= end + 1e-9)
    np.testing.assert_array_equal(inside(rows, f), within)


def test_of_a_wide_sector_controllers_plan_with_the_middle_half_turn_or_the_chosen_one() -> None:
    """Barred 60° astern, the middle is the half turn ahead."""
    wide = math.radians(210.0), math.radians(510.0)
    half = math.radians(270.0), math.radians(450.0)
    end = math.radians(330.0), math.radians(510.0)
    middle, ahead, chosen, last = (
        build_limit_rows_of_thrusters(one_azimuth(**sectors), 16)
        for sectors in (
            {"sector_rad": wide},
            {"sector_rad": half},
            {"sector_rad": wide, "controller_sector_rad": end},
            {"sector_rad": end},
        )
    )
    np.testing.assert_allclose(middle.G, ahead.G, atol=1e-12)
    np.testing.assert_array_equal(chosen.G, last.G)


@pytest.mark.parametrize("start_deg", [-90.0, 0.0, 120.0, 123.4, 240.0])
def test_both_edges_of_a_half_turn_are_one_row(start_deg: float) -> None:
    """Two rows a rounding apart would leave no certificate of which is active."""
    half = math.radians(start_deg), math.radians(start_deg + 180.0)
    thrusters = one_azimuth(sector_rad=half)
    rows = build_limit_rows_of_thrusters(thrusters, 16)
    of_azimuth = rows.G[rows.thruster == 0, :2]
    assert len(of_azimuth) == 16 // 2 + 1
    across = of_azimuth[:, :1] * of_azimuth[:, 1] - of_azimuth[:, 1:] * of_azimuth[:, 0]
    own = np.eye(len(of_azimuth), dtype=bool)
    assert np.abs(across[~own]).min() > 1e-3
    low, high, _ = rows.limits_after_loss_of_thrusters({0})
    zero = (low == 0.0) & (high == 0.0)
    assert np.linalg.matrix_rank(rows.G[zero]) == np.count_nonzero(zero) == 2


def test_a_lost_azimuth_is_held_at_zero_by_two_rows_alone() -> None:
    rows = build_limit_rows_of_thrusters(
        one_azimuth(sector_rad=(math.radians(-40.0), math.radians(100.0))), 16
    )
    low, high, _ = rows.limits_after_loss_of_thrusters({0})
    own = rows.thruster == 0
    touched = own & ((low == 0.0) | (high == 0.0))
    assert np.count_nonzero(touched) == 2
    np.testing.assert_array_equal(low[touched], high[touched])
    # The two normals lie across each other.
    assert abs(np.linalg.det(rows.G[touched][:, :2])) == pytest.approx(1.0)


@pytest.mark.slow
@settings(derandomize=True, max_examples=100)
@given(
    st.floats(0.0, 1.0),
    st.floats(-math.pi, math.pi),
    st.floats(-1.0, 1.0),
    st.sets(st.integers(0, 2)),
    st.floats(0.1, 3.0),
)
def test_the_straight_way_back_keeps_to_the_rate_and_to_what_the_rows_become(
    share: float, angle: float, tunnel: float, lost: set[int], sample_s: float
) -> None:
    thrusters = one_azimuth()
    rows, du_max = (
        build_limit_rows_of_thrusters(thrusters, 16),
        thrusters.largest_force_changes_per_sample(sample_s),
    )
    row_max = np.sqrt(((rows.G * du_max) ** 2).sum(axis=1))
    size = share * T * math.cos(math.pi / 16)
    f = np.array([size * math.cos(angle), size * math.sin(angle), 8e4 * tunnel, -1.2e5 * share])
    N_c = 6
    ramp_down = LimitRampDown(rows, du_max, row_max, N_c)
    least, most = ramp_down.compute_gradually_tightened_limits(
        f, rows.limits_after_loss_of_thrusters(lost)
    )
    before = f
    for i in range(N_c):
        now = f.copy()
        for number, at in enumerate(thrusters.slices_in_force_vector):
            if number in lost:
                steps = float((np.abs(f[at]) / du_max[at]).max())
                left = steps - 0.9 * (i + 1)
                now[at] = f[at] * left / steps if left > 0.05 else 0.0
        assert (np.abs(now - before) <= du_max * (1 + 1e-12)).all()
        along, back = rows.G @ now, rows.G @ f
        rounding = 1e-9 * row_max
        assert (along <= back + most[i] * row_max + rounding).all()
        assert (along >= back + least[i] * row_max - rounding).all()
        before = now


@settings(derandomize=True, max_examples=100)
@given(
    st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4),
    st.sets(st.integers(0, 2)),
    st.floats(0.0, 1.0),
    st.integers(1, 4),
)
def test_limits_close_in_as_the_formula_says_wherever_they_are_written(
    parts: list[float], lost: set[int], left: float, behind: int
) -> None:
    thrusters, N_c = one_azimuth(), 3
    rows, du_max = (
        build_limit_rows_of_thrusters(thrusters, 8),
        thrusters.largest_force_changes_per_sample(1.0),
    )
    row_max, f = rows.largest_row_changes_per_step(du_max), T * np.array(parts)
    r, factor = len(row_max), np.linspace(0.5, 2.0, len(row_max))
    limits = rows.limits_after_loss_of_thrusters(lost)
    low, high = left * limits.low, left * limits.high
    stride = r + behind
    l, u = np.full(N_c * stride, 7.0), np.full(N_c * stride, 8.0)  # noqa: E741 - as in the program
    ramp = LimitRampDown(rows, du_max, row_max, N_c, factor=factor)
    ramp.write_limits(f, Limits(low, high, limits.lost), l, u)
    for k in range(r):
        number = rows.thruster[k]
        own, entries = np.flatnonzero(rows.thruster == number), rows.entry == number
        along = rows.G[:, entries] @ f[entries]
        steps = math.sqrt(((f[entries] / du_max[entries]) ** 2).sum())
        gauge = max(along[j] / (rows.high if along[j] > 0.0 else rows.low)[j] for j in own)
        for i in range(N_c):
            share = 1.0 - 0.9 * (i + 1) / steps if steps > 0.9 * (i + 1) + 0.05 else 0.0
            least, most = low[k], high[k]
            if number not in lost:
                least, most = min(least, share * along[k]), max(most, share * along[k])
            elif share > 0.0:
                least, most = share * gauge * rows.low[k], share * gauge * rows.high[k]
            expected = np.array([least, most]) - along[k]
            found = np.array([l[i * stride + k], u[i * stride + k]]) / factor[k] * row_max[k]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * T)
    of_others = np.arange(N_c * stride).reshape(N_c, stride)[:, r:]
    assert (l[of_others] == 7.0).all() and (u[of_others] == 8.0).all()

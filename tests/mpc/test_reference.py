"""The reference trajectory against an independent simulation of its filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lti, step

from dpbench.mpc.reference import ReferenceFilter, nearest_pose, reference_table

START, GOAL = np.array([1.0, -2.0, 0.1]), np.array([21.0, 13.0, 0.6])


def test_a_set_point_is_there_from_the_first_sample() -> None:
    """Without a filter every sample has the set-point."""
    np.testing.assert_array_equal(reference_table(START, GOAL, 5, 0.3), np.tile(GOAL, (5, 1)))


@pytest.mark.parametrize("damping", [0.7, 1.0])
def test_the_filter_is_the_third_order_transfer_function(damping: float) -> None:
    """η_d/η_r = ω³ / (s³ + (2ζ+1)ωs² + (2ζ+1)ω²s + ω³), stepped by scipy on its own."""
    period, sample_s, samples = 40.0, 0.3, 400
    omega = 2 * np.pi / period
    middle = 2 * damping + 1
    system = lti([omega**3], [1.0, middle * omega, middle * omega**2, omega**3])
    _, rise = step(system, T=np.arange(samples) * sample_s)
    table = reference_table(START, GOAL, samples, sample_s, ReferenceFilter(period, damping))
    expected = START + np.multiply.outer(rise, GOAL - START)
    np.testing.assert_allclose(table, expected, rtol=0, atol=1e-9)


def test_the_filter_starts_at_rest_and_arrives() -> None:
    """The first move is of third order in time; after ten periods the goal is met."""
    table = reference_table(START, GOAL, 2000, 0.3, ReferenceFilter(40.0))
    np.testing.assert_allclose(table[0], START, rtol=0, atol=1e-15)
    # ω³t³/6 of 20 m at t = 0.3 s is 3.5e-4 m.
    assert np.abs(table[1] - START).max() < 4e-4
    np.testing.assert_allclose(table[-1], GOAL, atol=1e-9)


def test_heading_goes_the_short_way() -> None:
    """A goal at -175° seen from 175° is at 185°, filtered or not."""
    start, goal = np.array([0.0, 0.0, np.radians(175)]), np.array([0.0, 0.0, np.radians(-175)])
    assert np.degrees(nearest_pose(goal, start)[2]) == pytest.approx(185.0)
    heading = np.degrees(reference_table(start, goal, 100, 0.3, ReferenceFilter(20.0))[:, 2])
    assert heading.min() >= 175.0 - 1e-9
    assert heading.max() <= 185.0 + 1e-9

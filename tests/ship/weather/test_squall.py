"""Squalls: their shape, their place among the slow forces and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dpbench.ship.environment import Environment, Squall

SQUALL = Squall(60.0, 5.0, 105.0, 30.0, np.array([-120e3, 340e3, 3000e3]))
STEADY = Environment(np.array([-30e3, 120e3, 600e3]), np.zeros(3), np.ones(3), np.zeros(3), 60.0)


@pytest.mark.parametrize(
    ("t_s", "share"),
    [(0, 0), (60, 0), (62.5, 0.5), (65, 1), (90, 1), (105, 1), (120, 0.5), (135, 0), (300, 0)],
)
def test_a_squall_rises_holds_and_decays_on_straight_lines(t_s: float, share: float) -> None:
    """The squall of the library grows within 5 s, holds to 105 s and is gone 30 s later."""
    gusty = replace(STEADY, squalls=(SQUALL, SQUALL))
    expected = STEADY.force(t_s) + 2 * share * SQUALL.force
    np.testing.assert_allclose(gusty.force(t_s), expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("t_s", "force"),
    [
        # A quarter of the mean after 15 s of a ramp of 60 s, and no squall yet
        (15.0, [-7.5e3, 30e3, 150e3]),
        # Half of the mean and half of the squall; half of the mean and all of it
        (30.0, [-75e3, 230e3, 1800e3]),
        (32.5, [-136.25e3, 405e3, 3325e3]),
        # All of the mean, and half of the squall that decays
        (80.0, [-90e3, 290e3, 2100e3]),
    ],
)
def test_a_squall_does_not_grow_with_the_ramp(t_s: float, force: list[float]) -> None:
    """The ramp multiplies the slow forces only; a squall has its own rise."""
    squall = replace(SQUALL, start_s=27.5, hold_until_s=65.0)
    gusty = replace(STEADY, squalls=(squall,))
    np.testing.assert_allclose(gusty.force(t_s), force, rtol=1e-13)


def test_a_squall_does_not_grow_with_the_ramp_of_a_stage_table() -> None:
    """The stage table half-way up the ramp has half the mean and the whole squall."""
    squall = replace(SQUALL, start_s=0.0, hold_until_s=65.0)
    gusty = replace(STEADY, squalls=(squall,))
    table = gusty.stage_table(31, 1.0, 1)
    # At 30 s, start of the last sample: half of the mean and the whole squall
    np.testing.assert_allclose(table[30, 0], [-135e3, 400e3, 3300e3], rtol=1e-12)

"""Squalls: their shape, their place among the slow forces and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dpbench.ship.environment import Environment
from dpbench.ship.weather.squall import Squall

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

"""What the two observers with a model share: the layout of their state, their start, their bias.

    x   0    3    6    9    12   15
        │ η  │ b  │ ν  │ ξ1 │ ξ2 │       three each: surge or north, sway or east, yaw
        └─ WITHOUT_WAVES ─┘      │       pose, bias, velocity
        └───── WITH_WAVES ───────┘       and the two states of the wave oscillators (`wave_filter`)

Numbers, because numba compiles a kernel with the value of a global number; see `ship.layout` for
what its cache does not see.
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.estimation.estimator import Estimator
from dpbench.ship.estimation.model_change import change_matrix
from dpbench.ship.layout import AXES, POSE, STATE, VELOCITY
from dpbench.ship.vessel import Vessel

ETA, BIAS, NU, XI1, XI2 = range(0, 5 * AXES, AXES)
WITHOUT_WAVES, WITH_WAVES = XI1, XI2 + AXES


class ModelObserver(Estimator):
    """An observer whose state x (n,) is laid out as the module says.

    Parameters
    ----------
    ship : M and D of the model, which need not be those of the true ship.
    sample_s : time between updates [s].
    states : n, `WITHOUT_WAVES` or `WITH_WAVES`.
    """

    def __init__(self, ship: Vessel, sample_s: float, states: int) -> None:
        self._J: Matrix = change_matrix(ship, sample_s)
        self._x: Vector = np.zeros(states)
        self._estimate, self.change = np.zeros(STATE), np.zeros(STATE)
        self._advance = False

    def start(self, state: Vector) -> None:
        """Begin at the state (6,), with neither bias nor wave motion."""
        self._x[...] = 0.0
        self._x[ETA:BIAS], self._x[NU:XI1] = state[POSE], state[VELOCITY]
        self._estimate[...] = state
        self.change[...] = 0.0
        self._advance = False

    @property
    def bias(self) -> Vector:
        """Estimated bias (3,), north, east, yaw [N, N, N·m]."""
        return self._x[BIAS:NU].copy()

"""Low-frequency environmental force b(t) in the north-east-down frame (paper section IV).

    b(t) = g(t) · (mean + amplitude · sin(2πt/T + phase)),   g(t) = min(t / ramp, 1)

The force does not depend on the ship, so a run evaluates it once at all stage times of the
integrator and the step loop only reads a table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dpbench.errors import InputError, ShapeError
from dpbench.qp.program import Matrix, Vector


@dataclass(frozen=True, eq=False)
class Environment:
    """Mean plus one sinusoid per axis, north, east, yaw.

    Parameters
    ----------
    mean, amplitude : (3,) [N, N, N·m].
    period_s : (3,) periods [s], positive.
    phase_rad : (3,) phases [rad].
    ramp_s : time over which the force grows from zero [s]; 0 for none.
    where : the file named in errors.
    """

    mean: Vector
    amplitude: Vector
    period_s: Vector
    phase_rad: Vector
    ramp_s: float = 0.0
    where: str = "Environment"

    def __post_init__(self) -> None:
        for name in ("mean", "amplitude", "period_s", "phase_rad"):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != (3,):
                raise ShapeError.of(self.where, name, array.shape, "shape (3,)")
            if not np.isfinite(array).all():
                raise InputError(self.where, name, array.tolist(), "finite numbers")
            object.__setattr__(self, name, array)
        if not (self.period_s > 0).all():
            raise InputError(self.where, "period_s", self.period_s.tolist(), "positive periods")
        if not self.ramp_s >= 0:
            raise InputError(self.where, "ramp_s", self.ramp_s, "a time of 0 s or more")

    def force(self, t_s: ArrayLike) -> Matrix:
        """b at the times t_s (...,): array (..., 3) [N, N, N·m]."""
        t = np.asarray(t_s, dtype=np.float64)[..., np.newaxis]
        b = self.mean + self.amplitude * np.sin(2 * np.pi * t / self.period_s + self.phase_rad)
        if self.ramp_s > 0:
            b *= np.minimum(t / self.ramp_s, 1.0)
        return b

    def stage_table(self, steps: int, sample_s: float, substeps: int) -> Matrix:
        """b at the stage times of Runge-Kutta 4: (steps, 2·substeps + 1, 3).

        Entry [k, 2i] is the start of sub-step i of sample k, [k, 2i + 1] its middle, and the last
        entry the end of the sample.
        """
        t = np.arange(steps)[:, np.newaxis] * sample_s
        t = t + np.linspace(0.0, sample_s, 2 * substeps + 1)
        return np.ascontiguousarray(self.force(t))

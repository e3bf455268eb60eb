"""Gains of the passive observer by the tuning rules of Fossen & Strand (1999).

    K11 = −2 (ζ_n − λ) ω_c / ω0,   K12 = 2 ω0 (ζ_n − λ),   K2 = ω_c,   K3 = (K3/K4) K4
    ζ_n > λ,   1/T_b < K3/K4 < ω0 < ω_c

They give the pose loop a notch at ω0 and the cut-off ω_c (equations in `passive_observer`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.ship.estimation.wave_filter import WaveModel
from dpbench.ship.validation import store_positive_vectors
from dpbench.ship.vessel import Vessel

CUTOFF_RATIO = 1.5
"""ω_c / ω0. The rules alone do not make the error loop passive: at the 1.1 / 0.8976 of Fossen's
example its phase reaches -95°, at 1.5 with the ratios below it stays above -90°."""
STIFFNESS_RATIO = 0.4
"""√(K4 / M) / ω0: how fast a pose error moves the speed."""
BIAS_RATIO = 0.1
"""(K3 / K4) / ω0: how fast it moves the bias."""
BIAS_TIME_RATIO = 1e4
"""T_b · ω0: a constant bias is short by K4 / (K3 T_b), a thousandth of it."""


@dataclass(frozen=True, eq=False)
class PassiveTuning:
    """Gains by the rules of the paper; axes north, east, yaw.

    Parameters
    ----------
    waves : peak and damping of the wave motion (its std is not used).
    notch_damping : (3,) ζ_n, above the damping λ of the waves; 1 gives -20 dB at the peak.
    cutoff_radps : (3,) ω_c, above ω0 [rad/s].
    K4 : (3,) gain of the pose error on the force [N/m, N/m, N·m/rad].
    bias_rate_radps : (3,) K3/K4 [rad/s], between 1/T_b and ω0.
    bias_time_s : (3,) T_b [s].
    wave_filter : False leaves the wave states out (K1 = 0).
    where : the file named in errors.

    Raises
    ------
    ShapeError, InputError : naming the key, what was found and what is allowed.
    """

    waves: WaveModel
    notch_damping: Vector
    cutoff_radps: Vector
    K4: Vector
    bias_rate_radps: Vector
    bias_time_s: Vector
    wave_filter: bool = True
    where: str = "PassiveTuning"

    def __post_init__(self) -> None:
        gains = "notch_damping", "cutoff_radps", "K4", "bias_rate_radps", "bias_time_s"
        store_positive_vectors(self, self.where, *gains)
        omega0, damping = self.waves.omega0_radps, self.waves.damping
        rules = (
            ("notch_damping", self.notch_damping > damping, f"above {damping.tolist()}"),
            ("cutoff_radps", self.cutoff_radps > omega0, f"above {omega0.tolist()}"),
            ("bias_rate_radps", self.bias_rate_radps < omega0, f"below {omega0.tolist()}"),
            ("bias_rate_radps", self.bias_rate_radps * self.bias_time_s > 1, "above 1/bias_time_s"),
        )
        for name, kept, allowed in rules:
            if not kept.all():
                raise InputError(self.where, name, getattr(self, name).tolist(), allowed)

    @classmethod
    def of_ship(
        cls,
        ship: Vessel,
        waves: WaveModel,
        *,
        wave_filter: bool = True,
        where: str = "PassiveTuning",
    ) -> PassiveTuning:
        """Gains in proportion to the ship's inertia and to the peak of the sea."""
        omega0 = waves.omega0_radps
        return cls(
            waves,
            np.ones(3),
            CUTOFF_RATIO * omega0,
            np.diag(ship.M) * (STIFFNESS_RATIO * omega0) ** 2,
            BIAS_RATIO * omega0,
            BIAS_TIME_RATIO / omega0,
            wave_filter,
            where,
        )

    @property
    def gains(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        """K11, K12, K2, K3, K4, (3,) each."""
        omega0, on = self.waves.omega0_radps, float(self.wave_filter)
        rise: Vector = on * 2 * (self.notch_damping - self.waves.damping)
        K3: Vector = self.bias_rate_radps * self.K4
        return -rise * self.cutoff_radps / omega0, rise * omega0, self.cutoff_radps, K3, self.K4

"""Conditions of a scenario: waves, sensors, estimator, and how the ship differs from the model."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Conditions:
    """Conditions of a scenario as its documents state them.

    Attributes
    ----------
    noise : standard deviations of the measured position [m] and heading [°].
    estimator : "measured" where the controller gets the measurement itself.
    thrust_loss_percent : share of surge, sway and yaw that never arrives.
    has_drag : whether the vessel has a nonlinear drag beside the linear damping of the model.
    seed : of gusts, waves and noise; None where nothing is random.
    is_fmu : whether an FMU, with a lag and mismatch of its own, is the ship.
    """

    has_waves: bool
    has_motion: bool
    noise: tuple[float, float]
    estimator: str
    has_wave_filter: bool
    lag_s: float
    delay_samples: int
    mass_percent: float
    damping_percent: float
    thrust_loss_percent: tuple[float, ...]
    has_drag: bool
    seed: int | None
    is_fmu: bool


def read_conditions(
    scenario: Mapping[str, Any], vessel: Mapping[str, Any] | None = None
) -> Conditions:
    """Return the conditions of a scenario file's tables, with those of its vessel's if given.

    Examples
    --------
    >>> read_conditions({"plant": {"thruster_lag_s": 2.0}}).lag_s
    2.0
    """
    weather, estimator = scenario.get("environment") or {}, scenario.get("estimator") or {}
    waves, noise = weather.get("waves") or {}, weather.get("noise") or {}
    plant, wind = scenario.get("plant") or {}, weather.get("wind")
    is_random = (
        (wind is not None and wind.get("gusts") != "none")
        or (bool(waves) and (waves.get("drift", True) or waves.get("motion") is not None))
        or any(noise.values())
    )
    return Conditions(
        has_waves=bool(waves),
        # A table without keys is one: the motion is then that of the waves of the weather.
        has_motion=waves.get("motion") is not None,
        noise=(noise.get("position_m") or 0.0, noise.get("heading_deg") or 0.0),
        estimator=estimator.get("kind", "measured"),
        has_wave_filter=estimator.get("wave_filter", True),
        lag_s=plant.get("thruster_lag_s") or 0.0,
        delay_samples=plant.get("delay_samples") or 0,
        mass_percent=plant.get("mass_percent") or 0.0,
        damping_percent=plant.get("damping_percent") or 0.0,
        thrust_loss_percent=tuple(plant.get("thrust_loss_percent") or ()),
        has_drag=(vessel or {}).get("drag", "linear") != "linear",
        seed=weather.get("seed", 0) if is_random else None,
        is_fmu=bool(plant.get("fmu")),
    )

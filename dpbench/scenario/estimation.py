"""The estimator of a scenario, tuned to its ship and to its sea."""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.scenario.tables.scenario_file import EstimatorTable, ScenarioFile
from dpbench.ship.estimation.estimator import Estimator, MeasuredState
from dpbench.ship.estimation.kalman import SENSOR_STD, KalmanFilter, KalmanTuning
from dpbench.ship.estimation.observer import WaveModel
from dpbench.ship.estimation.passive_observer import PassiveObserver, PassiveTuning
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

CALM_STD = np.array([0.05, 0.05, np.radians(0.05)])
"""Least wave motion that a filter assumes [m, m, rad]: one that expects none ignores all."""


@dataclass(frozen=True, eq=False)
class EstimatorChoice:
    """Estimator settings of a scenario, before the ship is known.

    waves, sensor_std : assumed wave motion, None where nothing is estimated, and noise (3,).
    """

    kind: str
    wave_filter: bool
    waves: WaveModel | None
    sensor_std: Vector
    where: str

    def build_estimator_for_ship(self, ship: Vessel, sample_s: float) -> Estimator:
        """Build the estimator for a ship and sample time."""
        if self.waves is None:
            return MeasuredState()
        if self.kind == "kalman":
            kalman = KalmanTuning.choose_for_ship(
                ship, self.waves, self.sensor_std, wave_filter=self.wave_filter, where=self.where
            )
            return KalmanFilter(ship, kalman, sample_s)
        passive = PassiveTuning.choose_for_ship(ship, self.waves, wave_filter=self.wave_filter)
        return PassiveObserver(ship, passive, sample_s)


def read_estimator_settings(spec: ScenarioFile, scale: Froude, where: str) -> EstimatorChoice:
    """Return the estimator settings of a scenario file, scaled to the ship."""
    place, table, sea = f"{where}: estimator", spec.estimator, spec.environment
    sensor = SENSOR_STD * scale.pose_factors
    if sea.noise is not None:
        sensor = np.maximum(sea.noise.compute_sensor_noise_std(scale), 0.1 * sensor)
    waves = None
    if table.kind != "measured":
        floor = CALM_STD * scale.pose_factors
        std = (
            floor
            if sea.waves is None
            else np.maximum(sea.waves.compute_wave_frequency_motion_std(scale), floor)
        )
        waves = WaveModel.from_peak_period(
            _require_peak_period_s(table, spec, place) * scale.time_and_speed_factor, std
        )
    return EstimatorChoice(table.kind, table.wave_filter, waves, sensor, place)


def _require_peak_period_s(table: EstimatorTable, spec: ScenarioFile, where: str) -> float:
    """Return the wave period [s] for the estimator; InputError where none is known."""
    if table.peak_period_s is not None:
        return table.peak_period_s
    if spec.environment.waves is None:
        allowed = "the peak period of the waves, since the weather has none"
        raise InputError(where, "peak_period_s", "nothing", allowed)
    return spec.environment.waves.tp_s

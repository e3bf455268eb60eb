"""The one typed description of a run, in SI: vessel, tuning, environment, reference, estimator."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.display import format_numbers_with_units, make_html_field_table
from dpbench.errors import (
    InputError,
    SituationError,
    UnknownNameError,
    format_key_path,
    require_integer_at_least,
    require_name_or_file,
    require_type,
    shorten_found,
)
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.reference import ReferenceFilter, build_smoothed_reference_table
from dpbench.scenario.controllers.controller import Controller, ControllerSpec
from dpbench.scenario.controllers.kinds import (
    CascadeController,
    ForceController,
    ThrusterController,
)
from dpbench.scenario.dotted_keys import copy_documents_with_values, read_validated_vessel_documents
from dpbench.scenario.plants.contract import refuse_loads_on_own_plant
from dpbench.scenario.plants.fmu_interface import hash_fmu, read_fmu_interface
from dpbench.scenario.plants.fmu_plant import FmuSource
from dpbench.scenario.problem_files import (
    ScenarioDocuments,
    VesselDocuments,
    find_problem_path,
    read_toml_as_dict,
    read_toml_as_model,
    validate_settings_as_model,
)
from dpbench.scenario.tables.scenario_file import EstimatorTable, FmuTable, ScenarioFile
from dpbench.scenario.tables.vessel_file import VesselFile
from dpbench.ship.actuators import Actuators, CommandedThrusters
from dpbench.ship.environment import Current, Environment
from dpbench.ship.estimation.estimator import Estimator, MeasuredState
from dpbench.ship.estimation.kalman import SENSOR_STD, KalmanFilter, KalmanTuning
from dpbench.ship.estimation.observer import PassiveObserver, PassiveTuning, WaveModel
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

CALM_STD = np.array([0.05, 0.05, np.radians(0.05)])
"""Least wave motion that a filter assumes [m, m, rad]: one that expects none ignores all."""
MAX_STEPS = 1_000_000
"""A run keeps every step in memory; a million of them is 83 hours of the paper's ship."""

CONTROLLERS: dict[str, Callable[[ControllerSpec], Controller]] = {
    "forces": ForceController.from_specification,
    "thrusters": ThrusterController.from_specification,
    "cascade": CascadeController.from_specification,
}
"""Makers of controllers by `controller.kind`; each raises InputError for a vessel or faults that do
not fit it."""
_FREE = ("name", "steps", "files")
"""Fields of a scenario that may differ from what its files say."""


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
        """Return a new state estimator for a ship and sample time."""
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
        allowed = (
            "the wave peak period [s] for the filter, as the weather of the scenario has no waves "
            "to take it from"
        )
        raise InputError(where, "peak_period_s", "nothing", allowed)
    return spec.environment.waves.tp_s


@dataclass(frozen=True, eq=False)
class Scenario:
    """Complete description of a closed-loop run, in SI units.

    Parameters
    ----------
    vessel, true_ship : the ship in the controller's model, and the true one.
    actuators : losses and delays between a command and the hull; None for nothing.
    estimation : the estimator of the ship's state.
    steps, sample_s : number and length [s] of samples.
    start, reference : (3,) poses [n, e, ψ] in m, m, rad.
    velocity : (3,) of the start, [u, v, r] over ground along the ship's axes in m/s, m/s, rad/s.
    smoothed, preview : reference filter, and whether the controller sees the reference coming.
    files : the documents from which `build_scenario_from_documents` makes it again.
    fmu : functional mock-up unit that replaces `true_ship`; None for none.

    Examples
    --------
    >>> scenario = load_scenario("paper")
    >>> scenario
    <Scenario paper: supply_fs99, tuning paper 30/5, 1000 steps of 0.3 s>
    >>> scenario.truncate(10).steps
    10
    """

    name: str
    title: str
    shows: str
    vessel: Vessel
    true_ship: Vessel
    actuators: Actuators | CommandedThrusters | None
    environment: Environment
    estimation: EstimatorChoice
    steps: int
    sample_s: float
    start: Vector
    velocity: Vector
    reference: Vector
    smoothed: ReferenceFilter | None
    preview: bool
    controller: Controller
    files: ScenarioDocuments
    fmu: FmuSource | None = None

    def __repr__(self) -> str:
        controller = self.controller.tuning_horizons_and_command_text
        return (
            f"<Scenario {self.name}: {self.vessel.id}, {controller}, "
            f"{self.steps} steps of {self.sample_s:.4g} s>"
        )

    def _repr_html_(self) -> str:
        """Return the scenario as an HTML table, which a notebook displays."""
        units = ("m", "m", "rad")
        fields = {
            "shows": self.shows,
            "vessel": f"{self.vessel.title} ({self.vessel.id})",
            "controller": self.controller.tuning_horizons_and_command_text,
            "length": f"{self.steps} steps of {self.sample_s:.4g} s",
            "start": format_numbers_with_units(self.start, units),
            "reference": format_numbers_with_units(self.reference, units),
            "most in one step": format_numbers_with_units(self.force_step_max, ("N", "N", "N·m")),
            "state": self.estimation.kind,
            "amplitude limits": self.controller.amplitude,
        }
        return make_html_field_table(f"{self.name}: {self.title}", fields)

    @property
    def problem(self) -> ControlProblem:
        """Control problem of the MPC: model, horizons, weights and limits, in SI units.

        Examples
        --------
        >>> problem = load_scenario("paper").problem
        >>> problem.N_p, problem.N_c
        (30, 5)
        """
        return self.controller.problem

    @property
    def force_step_max(self) -> Vector:
        """Largest change of the force (3,) [N, N, N·m] in one sample.

        Examples
        --------
        >>> load_scenario("paper").force_step_max
        array([ 32736.,  11008., 475200.])
        """
        return self.vessel.largest_force_change_per_sample(self.sample_s)

    @property
    def first_state(self) -> Vector:
        """State (6,) [u, v, r, n, e, ψ] of the ship at the first sample.

        Examples
        --------
        >>> load_scenario("paper").first_state
        array([0. , 0. , 0. , 1.2, 1.3, 0. ])
        """
        return np.concatenate([self.velocity, self.start])

    def build_reference_table(self, samples: int) -> Matrix:
        """Return the reference pose at each sample (samples, 3), heading unwrapped.

        Examples
        --------
        >>> load_scenario("paper").build_reference_table(2)
        array([[0., 0., 0.],
               [0., 0., 0.]])
        """
        return build_smoothed_reference_table(
            self.start, self.reference, samples, self.sample_s, self.smoothed
        )

    def estimator(self) -> Estimator:
        """Return a new state estimator, started at the ship's state of the first sample.

        Examples
        --------
        >>> type(load_scenario("paper").estimator()).__name__
        'MeasuredState'
        """
        estimator = self.estimation.build_estimator_for_ship(self.vessel, self.sample_s)
        estimator.start_from_state(self.first_state)
        return estimator

    def with_horizons(self, prediction_horizon: int, control_horizon: int) -> "Scenario":
        """Return a copy of the scenario with other horizons N_p and N_c, also in its name.

        Raises InputError for impossible ones, and as `with_keys`.

        Examples
        --------
        >>> load_scenario("paper").with_horizons(30, 8)
        <Scenario paper-30-8: supply_fs99, tuning paper 30/8, 1000 steps of 0.3 s>
        """
        N_p, N_c = (
            horizon.item() if isinstance(horizon, np.generic) else horizon
            for horizon in (prediction_horizon, control_horizon)
        )
        values = {"controller.prediction_horizon": N_p, "controller.control_horizon": N_c}
        return self._copy_with_keys(
            values, f"-{N_p}-{N_c}", f"{self.name} with horizons {N_p}/{N_c}"
        )

    def with_keys(self, values: Mapping[str, object]) -> "Scenario":
        """Return a copy of the scenario with other values of some keys, also in its name.

        values : in the units of the files, by dotted key as in a study, such as
            `environment.wind.speed_mps`, or `environment.wind` for a whole table, as of wind where
            the scenario has none.

        Raises InputError for an unknown key or a bad value, or where parts of the scenario were
        replaced without its files.

        Examples
        --------
        >>> stormy = load_scenario("weather").with_keys({"environment.wind.speed_mps": 16.0})
        >>> stormy.name, stormy.environment.wind.speed_mps
        ('weather-environment.wind.speed_mps=16.0', 16.0)
        """
        require_type("values", values, Mapping, "a mapping from keys to values")
        for key in values:
            require_type("values", key, str, "keys as text, such as 'environment.seed'")
        values = {
            key: value.tolist() if isinstance(value, np.generic | np.ndarray) else value
            for key, value in values.items()
        }
        suffix = "".join(
            f"-{key}" if isinstance(value, Mapping | list | tuple) else f"-{key}={value}"
            for key, value in values.items()
        )
        # A name goes into those of files and QPs.
        suffix = re.sub(r"[^\w.=+-]+", "_", suffix)
        return self._copy_with_keys(values, suffix, f"{self.name} with other keys")

    def _copy_with_keys(self, values: Mapping[str, object], suffix: str, where: str) -> "Scenario":
        """Return a copy with values of dotted keys replaced and a suffix to its name."""
        own = build_scenario_from_documents(self.files)
        for field in fields(self):
            mine, filed = getattr(self, field.name), getattr(own, field.name)
            if field.name not in _FREE and _list_values(mine) != _list_values(filed):
                found = f"{field.name} changed in place; a copy would lose this change"
                raise InputError(where, "", found, "changes with `with_keys` and `with_horizons`")
        files = copy_documents_with_values(self.files, values, where)
        files["name"] = self.name + suffix
        # Plain values with every key, so that the copy's keys can be changed again.
        spec = validate_settings_as_model(files["scenario"], ScenarioFile, where)
        files["scenario"] = spec.model_dump()
        built = build_scenario_from_documents(files, where=where, vessel_where=f"{where}: vessel")
        return built if self.steps == own.steps else built.truncate(self.steps)

    def truncate(self, steps: int) -> "Scenario":
        """Return a copy of the scenario cut to its first `steps` samples.

        Examples
        --------
        >>> load_scenario("paper").truncate(10)
        <Scenario paper: supply_fs99, tuning paper 30/5, 10 steps of 0.3 s>
        """
        steps = require_integer_at_least(f"scenario {self.name}: steps", steps, 1)
        return replace(self, steps=min(steps, self.steps))


def _list_values(part: object) -> object:
    """Return a part of a scenario as nested tuples and texts, equal where its values are."""
    if isinstance(part, np.ndarray):
        return part.shape, part.tobytes()
    if is_dataclass(part):
        named = {field.name: getattr(part, field.name) for field in fields(part)}
        # Where a part was read from is not a value.
        return type(part), *(_list_values(value) for key, value in named.items() if key != "where")
    if isinstance(part, tuple | list):
        return tuple(map(_list_values, part))
    return repr(part)


def load_scenario(name_or_path: str | Path, *, beside: Path | None = None) -> Scenario:
    """Return a scenario by name or from a TOML file; `scenario@vessel` replaces its vessel.

    A relative path is looked for in the folder `beside` first, then in the working folder. Raises
    InputError : one line naming file, key, what was found and what is allowed.
    TypeError : neither a name nor a path.

    Examples
    --------
    >>> load_scenario("paper").steps
    1000
    """
    require_name_or_file("scenario", name_or_path, "a TOML file")
    name, at, other = str(name_or_path).partition("@")
    path = find_problem_path("scenarios", name, beside)
    scenario = read_toml_as_model(path, ScenarioFile)
    if scenario.plant.fmu is not None:
        scenario = _check_and_identify_fmu(scenario, scenario.plant.fmu, path)
    vessel = other if at else scenario.vessel
    try:
        vessel_path = find_problem_path("vessels", vessel, beside=path.parent)
    except InputError as error:
        where = str(name_or_path) if at else str(path)
        is_name = isinstance(error, UnknownNameError)
        found = repr(vessel) if is_name else f"{error.found} {vessel!r}"
        raise UnknownNameError(where, "vessel", found, error.allowed) from None
    files: ScenarioDocuments = {
        "name": f"{path.stem}@{vessel_path.stem}" if other else path.stem,
        "scenario": scenario.model_dump(),
        **read_validated_vessel_documents(vessel_path),
    }
    return build_scenario_from_documents(files, where=str(path), vessel_where=str(vessel_path))


def _check_and_identify_fmu(spec: ScenarioFile, table: FmuTable, path: Path) -> ScenarioFile:
    """Return a scenario file whose FMU is found, checked and identified by its SHA-256."""
    file = next((p for p in (path.parent / table.file, Path(table.file)) if p.is_file()), None)
    if file is None:
        allowed = "an FMU; a relative path starts at the folder of the scenario file"
        raise InputError(str(path), "plant.fmu.file", f"no such file {table.file!r}", allowed)
    read_fmu_interface(file, table, str(path))
    own = hash_fmu(file)
    if table.sha256 not in ("", own):
        raise InputError(
            str(path), "plant.fmu.sha256", repr(table.sha256), f"{own}, the hash of {file}"
        )
    found = table.model_copy(update={"file": str(file), "sha256": own})
    return spec.model_copy(update={"plant": spec.plant.model_copy(update={"fmu": found})})


def load_vessel(name_or_path: str | Path) -> Vessel:
    """Return a vessel by name or from a TOML file."""
    path = find_problem_path("vessels", name_or_path)
    document = read_toml_as_dict(path)
    if "controller" in document:
        raise SituationError(str(path), "found a scenario; required: a vessel")
    file = validate_settings_as_model(document, VesselFile, str(path))
    return file.build_vessel(path.stem, str(path))


def build_vessel_from_documents(files: VesselDocuments, where: str = "vessel") -> Vessel:
    """Return the vessel that the contents of its file describe."""
    return validate_settings_as_model(files["vessel"], VesselFile, where).build_vessel(
        files["vessel_name"], where
    )


def build_scenario_from_documents(
    files: ScenarioDocuments, where: str = "scenario", vessel_where: str = "vessel"
) -> Scenario:
    """Return the scenario that the contents of its files (JSON-compatible) describe."""
    spec = validate_settings_as_model(files["scenario"], ScenarioFile, where)
    ship_file = validate_settings_as_model(files["vessel"], VesselFile, vessel_where)
    vessel = ship_file.build_vessel(files["vessel_name"], vessel_where)
    scale = Froude(ship_file.model_scale)
    plant = spec.plant
    sample_s = spec.sample_s * scale.time_and_speed_factor
    if not 1 <= spec.steps <= MAX_STEPS:
        longest_s, samples = MAX_STEPS * spec.sample_s, f"1 to {MAX_STEPS} samples"
        allowed = f"{spec.sample_s:g} to {longest_s:g} s, which is {samples} of {spec.sample_s:g} s"
        raise InputError(where, "duration_s", spec.duration_s, allowed)
    for number, fault in enumerate(spec.faults):
        if fault.at_s >= spec.duration_s:
            allowed = f"a time before the end of the run, {spec.duration_s:g} s (duration_s)"
            key = format_key_path(["faults", number, "at_s"])
            raise InputError(where, key, f"{fault.at_s:g}", allowed)
    true_ship = replace(vessel, where=f"{where}: plant").copy_with_model_mismatch(
        plant.mass_percent, plant.damping_percent
    )
    environment = spec.environment.build_environment(scale)
    if plant.fmu is not None:
        refuse_loads_on_own_plant(environment, where)
    if vessel.drag is not None and environment.current is None:
        # Drag acts on the velocity through the water, which a current at rest puts into the tables.
        environment = replace(environment, current=Current(0.0, 0.0))
    made_from = ControllerSpec(spec, vessel, sample_s, scale, where)
    controller = CONTROLLERS[spec.controller.kind](made_from)
    # An error before anything runs: wind and drift need data of the hull.
    environment.wind_and_drift_coefficients(vessel)
    return Scenario(
        name=files["name"],
        title=spec.title,
        shows=spec.shows,
        vessel=vessel,
        true_ship=true_ship,
        actuators=_build_actuators_if_any(spec, controller, sample_s, scale),
        environment=environment,
        estimation=read_estimator_settings(spec, scale, where),
        steps=spec.steps,
        sample_s=sample_s,
        start=spec.start.to_pose_vector() * scale.pose_factors,
        velocity=spec.start.to_velocity_vector() * scale.velocity_factors,
        reference=spec.reference.to_pose_vector() * scale.pose_factors,
        smoothed=spec.reference.build_reference_filter_if_any(scale),
        preview=spec.reference.preview,
        controller=controller,
        files=files,
        fmu=None if plant.fmu is None else FmuSource.from_table(plant.fmu, sample_s, where),
    )


def build_or_reuse_scenario(files: ScenarioDocuments) -> Scenario:
    """Return the scenario of file contents, built or from a cache, with the weather's seed set."""
    weather = files["scenario"].get("environment", {})
    if not isinstance(weather.get("seed"), int):
        return _build_cached_scenario_from_json(json.dumps(files, sort_keys=True))
    calm = {**files, "scenario": {**files["scenario"], "environment": {**weather, "seed": 0}}}
    scenario = _build_cached_scenario_from_json(json.dumps(calm, sort_keys=True))
    sea = replace(scenario.environment, seed=weather["seed"])
    return replace(scenario, environment=sea, files=files)


@lru_cache(maxsize=64)
def _build_cached_scenario_from_json(files: str) -> Scenario:
    """Return the scenario of documents given as JSON; cached."""
    return build_scenario_from_documents(json.loads(files))


def _build_actuators_if_any(
    spec: ScenarioFile, controller: Controller, sample_s: float, scale: Froude
) -> Actuators | CommandedThrusters | None:
    """Return a model of thrust losses, delay and lag; None where commands act as they are."""
    plant = spec.plant
    loss = np.array(plant.thrust_loss_percent)
    lag_s = plant.thruster_lag_s * scale.time_and_speed_factor
    losses = Actuators(1.0 - loss / 100.0, plant.delay_samples, lag_s / sample_s)
    if controller.commanded_thrusters is not None:
        control = controller.commanded_thrusters
        return CommandedThrusters(control.thrusters, sample_s, lag_s, losses, control.trips)
    return losses if loss.any() or plant.delay_samples or lag_s > 0.0 else None


def resolve_to_scenario(given: object) -> Scenario:
    """Return a scenario that is given as an object, by name or as a TOML file.

    Raises TypeError for anything else, and what `load_scenario` raises.
    """
    if isinstance(given, (str, Path)):
        return load_scenario(given)
    if isinstance(given, Scenario):
        return given
    found, allowed = shorten_found(given), "a Scenario, a name or a TOML file"
    raise TypeError(f"scenario: found {found}; allowed: {allowed}")


def condense(scenario: Scenario | str | Path, *, units: UnitSystem = "scaled") -> CondensedQP:
    """Return the builder of a scenario's condensed QPs, in scaled or SI units.

    scenario : an object, a name or a TOML file.

    Examples
    --------
    >>> condense("paper").P.shape
    (15, 15)
    """
    return resolve_to_scenario(scenario).controller.make_condensed_qp_builder(units)

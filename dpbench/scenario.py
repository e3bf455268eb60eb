"""The one typed description of a run, in SI: vessel, tuning, environment, reference, duration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.errors import InputError, UnknownNameError
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import prediction_model
from dpbench.problem_files import parse_model, problem_path, read_model
from dpbench.problem_tables import ScenarioFile, VesselFile
from dpbench.qp.program import Matrix, Vector
from dpbench.ship.environment import Environment
from dpbench.ship.vessel import Vessel

MAX_STEPS = 1_000_000
"""A run keeps every step in memory; a million of them is 83 hours of the paper's ship."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A run in SI units.

    Parameters
    ----------
    name : name of the file; title, shows : what it is and what it is for.
    vessel, environment : the ship and the sea.
    steps, sample_s : how many samples of what length [s].
    start, reference : (3,) poses [n, e, ψ] in m, m, rad.
    N_p, N_c, Q, R, psi0_rad : horizons, weights (3, 3) in SI, heading of the model.
    files : the documents it was made from, from which `scenario_of` makes it again.
    """

    name: str
    title: str
    shows: str
    vessel: Vessel
    environment: Environment
    steps: int
    sample_s: float
    start: Vector
    reference: Vector
    N_p: int
    N_c: int
    Q: Matrix
    R: Matrix
    psi0_rad: float
    tuning: str
    files: dict[str, Any]

    @property
    def du_max(self) -> Vector:
        """Δu_max (3,) [N, N, N·m]."""
        return self.vessel.step_max(self.sample_s)

    def control_problem(self) -> ControlProblem:
        """What the controller is given: the model at ψ0, horizons, weights, limits."""
        ship = self.vessel
        model = prediction_model(ship.M, ship.D, self.psi0_rad, self.sample_s)
        return ControlProblem(
            model, self.N_p, self.N_c, self.Q, self.R, ship.tau_min, ship.tau_max, self.du_max
        )

    def first(self, steps: int) -> Scenario:
        """The same run cut to its first `steps` samples; InputError below 1."""
        if steps < 1:
            raise InputError(f"scenario {self.name}", "steps", steps, "1 or more")
        return replace(self, steps=min(steps, self.steps))


def load_scenario(name_or_path: str | Path, *, beside: Path | None = None) -> Scenario:
    """A scenario by name (a file under `problems/scenarios/`) or TOML path.

    A relative path is looked for in the folder `beside` first, then in the working folder.

    Raises
    ------
    InputError : one line naming file, key, what was found and what is allowed.
    """
    path = problem_path("scenarios", name_or_path, beside)
    scenario = read_model(path, ScenarioFile)
    try:
        vessel_path = problem_path("vessels", scenario.vessel, beside=path.parent)
    except InputError as error:
        found = repr(scenario.vessel)
        raise UnknownNameError(str(path), "vessel", found, error.allowed) from error
    files = {
        "name": path.stem,
        "vessel_name": vessel_path.stem,
        "scenario": scenario.model_dump(),
        "vessel": read_model(vessel_path, VesselFile).model_dump(),
    }
    return scenario_of(files, where=str(path), vessel_where=str(vessel_path))


def load_vessel(name_or_path: str | Path) -> Vessel:
    """A vessel by name (a file under `problems/vessels/`) or TOML path."""
    path = problem_path("vessels", name_or_path)
    return read_model(path, VesselFile).vessel(path.stem, str(path))


def scenario_of(
    files: dict[str, Any], where: str = "scenario", vessel_where: str = "vessel"
) -> Scenario:
    """The scenario of the documents in `files` (`Scenario.files`, JSON-compatible)."""
    spec = parse_model(files["scenario"], ScenarioFile, where)
    vessel = parse_model(files["vessel"], VesselFile, vessel_where).vessel(
        files["vessel_name"], vessel_where
    )
    sea, controller = spec.environment, spec.controller
    per_kN = 1000.0
    environment = Environment(
        per_kN * np.array(sea.mean_kN),
        per_kN * np.array(sea.amplitude_kN),
        np.array(sea.period_s),
        np.array(sea.phase_rad),
        sea.ramp_s,
        f"{where}: environment",
    )
    du_max = vessel.step_max(spec.sample_s)
    relative = controller.move_weight_relative
    R = np.array(controller.move_weight if relative is None else relative / du_max**2)
    steps = round(spec.duration_s / spec.sample_s)
    if not 1 <= steps <= MAX_STEPS:
        allowed = f"1 to {MAX_STEPS} samples of {spec.sample_s:g} s"
        raise InputError(where, "duration_s", spec.duration_s, allowed)
    return Scenario(
        name=files["name"],
        title=spec.title,
        shows=spec.shows,
        vessel=vessel,
        environment=environment,
        steps=steps,
        sample_s=spec.sample_s,
        start=spec.start.pose(),
        reference=spec.reference.pose(),
        N_p=controller.prediction_horizon,
        N_c=controller.control_horizon,
        Q=np.diag(controller.output_weight),
        R=np.diag(R),
        psi0_rad=float(np.radians(controller.model_heading_deg)),
        tuning=controller.tuning,
        files=files,
    )


def condense(scenario: Scenario, *, units: UnitSystem = "scaled") -> CondensedQP:
    """The builder of the scenario's QPs, in scaled units or SI."""
    return CondensedQP(scenario.control_problem(), units=units)

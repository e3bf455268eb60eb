"""Look into the design of controllers in ships: eigenvalues, gains, conditioning, region.

A design is the controller of one scenario in one vessel, in the weather of `calm` and in still
water.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.arrays import Matrix
from dpbench.bench.design.design_file import DesignRecord, Rows
from dpbench.bench.design.region_of_attraction import DURATION_S, froude_of, region_of_attraction
from dpbench.bench.plan.suite import DesignTable
from dpbench.errors import InputError
from dpbench.mpc.law import design_figures
from dpbench.scenario.problem_files import problem_path
from dpbench.scenario.scenario import load_scenario, scenario_of

WEATHER = "calm"
"""The scenario whose weather the ship is held in."""
STILL = "still water"


@dataclass(frozen=True, eq=False)
class Design:
    """A design to look into: `files` as in `Scenario.files`, in the weather of `calm`."""

    controller: str
    files: dict[str, Any]

    @property
    def vessel(self) -> str:
        """Name of the vessel."""
        return str(self.files["vessel_name"])


def plan_designs(table: DesignTable, beside: Path | None = None) -> list[Design]:
    """Every controller of the table in every vessel of it; paths are relative to `beside`.

    Raises
    ------
    InputError : for an unknown or a bad file, or two of one name.
    """
    controllers = [load_scenario(name, beside=beside) for name in table.controllers]
    vessels = [problem_path("vessels", name, beside) for name in table.vessels]
    for key, names in (
        ("controllers", [controller.name for controller in controllers]),
        ("vessels", [vessel.stem for vessel in vessels]),
    ):
        for name in names:
            if names.count(name) > 1:
                allowed = "files of different names, each once"
                raise InputError("suite", f"design.{key}", f"{name!r} twice", allowed)
    designs = []
    for controller in controllers:
        theirs = controller.files["scenario"]
        for vessel in vessels:
            files = load_scenario(f"{WEATHER}@{vessel.resolve()}").files
            ours = files["scenario"] | {
                "sample_s": theirs["sample_s"],
                "duration_s": DURATION_S,
                "controller": theirs["controller"],
            }
            # Said here, before anything runs: what the two cannot make together.
            scenario_of(files | {"scenario": ours}, where=f"suite: design: {controller.name}")
            designs.append(Design(controller.name, files | {"scenario": ours}))
    return designs


def design_record(design: Design) -> DesignRecord:
    """Look into a design; the some fifty trials of its regions take about ten seconds."""
    began = time.perf_counter()
    scenario = scenario_of(design.files)
    documents = design.files["scenario"]
    still = scenario_of(design.files | {"scenario": documents | {"environment": {}}})
    figures, vessel = design_figures(scenario.control_problem()), scenario.vessel
    regions = region_of_attraction(still, STILL), region_of_attraction(scenario, WEATHER)
    largest = np.maximum(vessel.tau_max, -vessel.tau_min)
    return DesignRecord(
        vessel=design.vessel,
        controller=design.controller,
        tuning=scenario.tuning,
        terminal=scenario.terminal,
        N_p=scenario.N_p,
        N_c=scenario.N_c,
        sample_s=scenario.sample_s,
        length_m=vessel.length_m,
        model_scale=froude_of(scenario).ratio,
        ramp_s=float((largest / vessel.rate_max).max()),
        eigenvalues=tuple((float(root.real), float(root.imag)) for root in figures.eigenvalues),
        spectral_radius=figures.spectral_radius,
        K_mpc=_rows(figures.K_mpc),
        K_y=_rows(figures.K_y),
        states=len(figures.eigenvalues),
        controllable=figures.controllable,
        condition_scaled=figures.condition_scaled,
        condition_si=figures.condition_si,
        regions=regions,
        wall_s=time.perf_counter() - began,
    )


def _rows(matrix: Matrix) -> Rows:
    return tuple(tuple(float(value) for value in row) for row in matrix)


def design_records(
    controllers: Sequence[str], vessels: Sequence[str], beside: Path | None = None
) -> list[DesignRecord]:
    """Look into every controller in every vessel, in this process, one after the other."""
    table = DesignTable(controllers=list(controllers), vessels=list(vessels))
    return [design_record(design) for design in plan_designs(table, beside)]

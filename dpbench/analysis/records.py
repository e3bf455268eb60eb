"""Look into the records: which runs belong to which question, and the step times of a replay."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from dpbench.analysis.statistics import Floats
from dpbench.analysis.step_times import StepTimes, step_times_of
from dpbench.bench.record.result_folder import Results
from dpbench.scenario.scenario import Scenario, scenario_of
from dpbench.solvers.calibration import CALIBRATION

RunRecord = Mapping[str, Any]
"""One row of `runs.parquet` with more of it: `default_route`, whether it runs on its solver's own;
`family`, `n` and `m` as drawn of a random sequence, the family empty for every other row."""

COMMON = "condensed_box"
"""The formulation that solvers are compared in."""


class Records:
    """The records of one result folder, asked by question.

    `all_runs`: each row is one of `runs`, which are about the ship, of `slowed`, closed loops on a
    slow computer, of `random`, which have no ship, or of another formulation than the common one of
    its problem; what is selected below is selected from `runs`, so that nothing mixes formulations,
    nor a solver's mistakes with a computer's. The harness's own configurations are no solvers: they
    are in `calibration` and nowhere else.
    """

    def __init__(self, results: Results) -> None:
        self.machine, self.suite = results.machine, results.suite
        rows = [
            {str(name): value for name, value in row.items()}
            for row in results.runs.to_dict("records")
        ]
        rows = [row | _random(row) for row in rows]
        self.calibration: list[RunRecord] = [row for row in rows if row["solver"] in CALIBRATION]
        rows = [row for row in rows if row["solver"] not in CALIBRATION]
        # What a solver is judged on is not for the random problems to say.
        usual = _default_routes(rows) | _default_routes([row for row in rows if not row["family"]])
        self.all_runs: list[RunRecord] = [
            row | {"default_route": row["route"] == usual[row["solver"]]} for row in rows
        ]
        self.delayed = [row for row in self.all_runs if as_float(row["slowdown"]) > 0.0]
        undelayed = [row for row in self.all_runs if not as_float(row["slowdown"]) > 0.0]
        self.runs = _commonly_formulated([row for row in undelayed if not row["family"]])
        self.random = [row for row in self.all_runs if row["family"]]
        self._steps = results.steps
        self._times: dict[str, StepTimes | None] = {}
        self._scenarios: dict[str, Scenario | None] = {}

    @cached_property
    def _rows_of(self) -> dict[str, tuple[int, int]]:
        """First and last row of each run in the step table, which is ordered by run."""
        ids = self._steps["run_id"].to_numpy()
        if len(ids) == 0:
            return {}
        edges = np.flatnonzero(ids[1:] != ids[:-1]) + 1
        starts, ends = [0, *edges.tolist()], [*edges.tolist(), len(ids)]
        return {str(ids[a]): (a, b) for a, b in zip(starts, ends, strict=True)}

    def steps(self, row: RunRecord) -> pd.DataFrame:
        """The step rows of a run; empty when it left none."""
        first, last = self._rows_of.get(str(row["run_id"]), (0, 0))
        return self._steps.iloc[first:last]

    def select(self, **wanted: object) -> list[RunRecord]:
        """Runs whose columns have the wanted values, or one of a tuple of values."""
        return [
            row
            for row in self.runs
            if all(
                row[name] in value if isinstance(value, tuple) else row[name] == value
                for name, value in wanted.items()
            )
        ]

    @cached_property
    def solvers(self) -> list[str]:
        """The solvers that are ranked, in the order of the suite: all but the baseline law."""
        return list(
            dict.fromkeys(str(r["solver"]) for r in self.all_runs if not is_baseline_law(r))
        )

    @cached_property
    def scenarios(self) -> list[str]:
        """Scenarios in the order of the suite."""
        return list(dict.fromkeys(str(row["scenario"]) for row in self.runs))

    def full_steps(self, scenario: str) -> int:
        """Steps of the longest closed loop of a scenario that the suite asks for; 0 if none."""
        asked = [r["steps_planned"] for r in self.select(mode="closed_loop", scenario=scenario)]
        return int(max(asked, default=0))

    def whole_steps(self, scenario: str) -> int:
        """Steps of the whole scenario; those the suite asks for where no row carries it."""
        found = self.scenario(scenario)
        return self.full_steps(scenario) if found is None else found.steps

    def is_whole(self, row: RunRecord) -> bool:
        """Whether a closed loop ran over the whole scenario, and not over its beginning only."""
        return as_float(row["steps_done"]) >= self.whole_steps(str(row["scenario"]))

    def full_loops(self, scenario: str, settings: str = "default") -> list[RunRecord]:
        """Full-length closed loops of a scenario in scaled units, the baseline law included."""
        loops = self.select(
            mode="closed_loop", scenario=scenario, settings=settings, units="scaled"
        )
        full = self.full_steps(scenario)
        return [row for row in loops if row["steps_planned"] == full]

    @cached_property
    def sequences(self) -> list[str]:
        """Replayed sequences in the order of the suite."""
        return list(dict.fromkeys(str(r["sequence"]) for r in self.select(mode="replay")))

    def replays(self, sequence: str, **wanted: object) -> list[RunRecord]:
        """Replays of a sequence in scaled units."""
        return self.select(mode="replay", sequence=sequence, units="scaled", **wanted)

    def times(self, row: RunRecord) -> StepTimes | None:
        """Step times of a replay; None when no counting round left a step."""
        run_id = str(row["run_id"])
        if run_id not in self._times:
            self._times[run_id] = step_times_of(self.steps(row))
        return self._times[run_id]

    def scenario(self, name: str) -> Scenario | None:
        """The scenario a run was made from; None when no row carries it."""
        if name not in self._scenarios:
            self._scenarios[name] = self._read_scenario(name)
        return self._scenarios[name]

    def _read_scenario(self, name: str) -> Scenario | None:
        for row in self.select(scenario=name):
            files = json.loads(row["cell"]).get("scenario") if row["cell"] else None
            if files and "scenario" in files:
                return scenario_of(files)
        return None


def _default_routes(rows: Sequence[RunRecord]) -> dict[str, str]:
    """The route each solver is judged on: qpsolvers where it ran so, else its first one."""
    usual: dict[str, str] = {}
    for row in rows:
        solver, route = str(row["solver"]), str(row["route"])
        if solver not in usual or route == "qpsolvers":
            usual[solver] = route
    return usual


def _commonly_formulated(rows: Sequence[RunRecord]) -> list[RunRecord]:
    """The rows in the common formulation of their problem, and those of the baseline law.

    Where a problem was never run in `COMMON`, its first formulation is the common one.
    """
    common: dict[tuple[str, ...], str] = {}
    for row in rows:
        found = str(row["formulation"])
        if not is_baseline_law(row) and (_problem(row) not in common or found == COMMON):
            common[_problem(row)] = found
    return [r for r in rows if is_baseline_law(r) or r["formulation"] == common[_problem(r)]]


def _problem(row: RunRecord) -> tuple[str, ...]:
    return tuple(str(row[name]) for name in ("mode", "scenario", "sequence", "units"))


def _random(row: RunRecord) -> dict[str, Any]:
    """What a replay without a scenario was made from, where that is a random recipe."""
    described = row["mode"] == "replay" and not row["scenario"] and row["cell"]
    source = json.loads(row["cell"]).get("source", {}) if described else {}
    if source.get("kind") != "random":
        return {"family": ""}
    recipe = source["recipe"]
    return {"family": str(recipe["family"]), "n": int(recipe["n"]), "m": int(recipe["m"])}


def is_baseline_law(row: RunRecord) -> bool:
    """Whether the row is the baseline law, which solves no QP and is never ranked."""
    return bool(row["formulation"] == "none")


def has_steps(row: RunRecord) -> bool:
    """Whether the run left rows."""
    return as_float(row["steps_done"]) > 0


def values(rows: Sequence[RunRecord], column: str) -> Floats:
    """A column of some runs as floats, missing ones NaN."""
    return np.array([as_float(row[column]) for row in rows], dtype=np.float64)


def as_float(value: object) -> float:
    """A number out of a table; a missing one (None, pd.NA, NaN) is NaN."""
    try:
        return float(value)  # type: ignore[arg-type] # any cell of a table; what fails is missing
    except (TypeError, ValueError):
        return float(np.nan)


def name_of(row: RunRecord) -> str:
    """The solver, with its route where that is not its default, its policy where not `fresh`."""
    extra = [] if row["default_route"] else [str(row["route"])]
    extra += [] if row["policy"] == "fresh" else [str(row["policy"])]
    return f"{row['solver']} ({', '.join(extra)})" if extra else str(row["solver"])


def configuration_name(row: RunRecord) -> str:
    """As `name_of`, with the settings where they are not `default`."""
    name, settings = name_of(row), str(row["settings"])
    if settings == "default":
        return name
    return f"{name[:-1]}, {settings})" if name.endswith(")") else f"{name} ({settings})"


def settings_level(settings: str) -> tuple[int, str]:
    """Sort key of a settings level."""
    order = ("default", "low", "mid", "high")
    return (order.index(settings) if settings in order else len(order), settings)

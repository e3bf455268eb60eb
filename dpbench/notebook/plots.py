"""The figures of the page for runs in memory; Altair is imported with the first."""

from typing import Any, Protocol

import numpy as np
import pandas as pd

from dpbench.errors import InputError
from dpbench.scenario.scenario import Scenario


class JudgedRun(Protocol):
    """Interface of a solver's run that can be plotted: label, table of steps, scenario."""

    @property
    def label(self) -> str:
        """Solver and way of starting each solve, as a plot's label."""

    @property
    def steps(self) -> pd.DataFrame:
        """Table with one row per step of the run."""

    @property
    def scenario(self) -> Scenario | None:
        """Scenario of a closed loop; None where recorded QPs were solved instead."""


class RunPlots:
    """Plots of one solver's run as Altair charts; `run.plot.ship(other)` draws several together.

    A chart has `save` for PNG, SVG, PDF and HTML.
    """

    def __init__(self, run: JudgedRun) -> None:
        self._run = run

    def __repr__(self) -> str:
        return "<figures: steps()" + (", ship(), errors()>" if self._run.scenario else ">")

    def steps(self) -> Any:
        """Plot step time, error of the first move, iterations and forces over the steps."""
        from dpbench.analysis.verdict.requirements import Requirements
        from dpbench.report.charts.steps import draw_step_strips

        run = self._run
        return draw_step_strips(
            _make_step_rows(run.steps), _compute_force_shares(run), Requirements().error_move
        )

    def ship(self, *others: JudgedRun) -> Any:
        """Plot the ship's path in the north-east plane with the 1 m circle (Fig. 4 of the paper).

        Raises InputError for a replay, which has no ship, or runs of two scenarios.
        """
        from dpbench.report.charts.ship import draw_path

        return draw_path(_convert_to_laws((self._run, *others)), self._common_scenario(others))

    def errors(self, *others: JudgedRun) -> Any:
        """Plot north, east, heading and radial error of closed loops (Fig. 5 of the paper)."""
        from dpbench.report.charts.ship import draw_pose_errors

        return draw_pose_errors(
            _convert_to_laws((self._run, *others)), self._common_scenario(others)
        )

    def _common_scenario(self, others: tuple[JudgedRun, ...]) -> Scenario:
        """Return the scenario that all runs share; InputError if they differ or one has no ship."""
        scenario = self._run.scenario
        for run in (self._run, *others):
            if run.scenario is None or scenario is None:
                raise InputError("plot", "run", "a replay", "a closed loop; a replay has no ship")
            if run.scenario.files != scenario.files:
                found = f"{scenario.name} and {run.scenario.name}"
                raise InputError("plot", "run", found, "closed loops of one scenario")
        assert scenario is not None, "of a closed loop"
        return scenario


def _convert_to_laws(runs: tuple[JudgedRun, ...]) -> list[Any]:
    """Convert solvers' runs to labelled curves of a plot; number those of equal label."""
    from dpbench.analysis.suites.paper import Law

    names = [run.label for run in runs]
    labels = [
        name if names.count(name) == 1 else f"{name} #{names[:i].count(name) + 1}"
        for i, name in enumerate(names)
    ]
    return [Law(label, run.steps) for label, run in zip(labels, runs, strict=True)]


def _make_step_rows(steps: pd.DataFrame) -> pd.DataFrame:
    """Return time [µs], error, iterations and active limits of each step, for a plot."""
    from dpbench.analysis.records.run_steps import counting_rows, run_steps
    from dpbench.report.charts.steps import NO_ANSWER

    ((_, run),) = run_steps(counting_rows(steps))
    return pd.DataFrame(
        {
            "k": run.k,
            "time_us": run.time_ns / 1e3,
            "raw_us": run.raw_ns / 1e3 if run.rounds > 1 else np.nan,
            "error": np.minimum(run.error, NO_ANSWER),
            "iterations": run.iterations,
            "active": run.n_active,
            "failed": run.failed,
        }
    )


def _compute_force_shares(run: JudgedRun) -> pd.DataFrame:
    """Return a closed loop's forces divided by their limits, by step; empty for a replay."""
    from dpbench.analysis.records.thinned_runs import FORCES as COLUMNS
    from dpbench.bench.record.schema import FORCES

    if run.scenario is None:
        return pd.DataFrame(columns=["k", "force", "share"])
    vessel = run.scenario.vessel
    limits = np.maximum(vessel.tau_max, -vessel.tau_min)
    tables = [
        pd.DataFrame({"k": run.steps["k"], "force": force, "share": run.steps[column] / limit})
        for force, column, limit in zip(FORCES, COLUMNS, limits, strict=True)
    ]
    return pd.concat(tables)

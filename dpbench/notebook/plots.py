"""Figures of runs and results in memory; Altair or Matplotlib is imported with the first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

import numpy as np
import pandas as pd

from dpbench.errors import InputError, shorten_found
from dpbench.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dpbench.report.page.data import PageData

Backend = Literal["altair", "matplotlib"]
"""Library that draws: Altair as on the page, or Matplotlib (extra `matplotlib`) for print."""


@dataclass(frozen=True)
class SharedData:
    """Data of a scenario that a figure draws once for all its runs, and their name in words."""

    name: str
    read: Callable[[Scenario], object]


SETPOINT = SharedData("the same setpoint", lambda scenario: scenario.reference.tolist())
START = SharedData(
    "the same start and setpoint",
    lambda scenario: (scenario.start.tolist(), scenario.reference.tolist()),
)
FORCE_LIMITS = SharedData(
    "one set of force limits",
    lambda scenario: (scenario.vessel.tau_min.tolist(), scenario.vessel.tau_max.tolist()),
)


class JudgedRun(Protocol):
    """Interface of a solver's run that can be plotted: label, table of steps, scenario."""

    @property
    def label(self) -> str:
        """Solver and way of starting each solve, as a plot's label."""

    @property
    def case_text(self) -> str:
        """Mode and name of the scenario or sequence that was run."""

    @property
    def steps(self) -> pd.DataFrame:
        """Table with one row per step of the run."""

    @property
    def scenario(self) -> Scenario | None:
        """Scenario of a ship's closed loop; None of a replay and of a plant that is no ship."""

    @property
    def signals(self) -> pd.DataFrame | None:
        """Outputs, references and inputs of a `LinearMPC` over time; None of other runs."""


class RunPlots:
    """Plots of one solver's run; `run.plot.ship(other)` draws several together.

    With `backend="altair"` a chart, whose `save` writes PNG, SVG, PDF and HTML; with "matplotlib" a
    `matplotlib.figure.Figure`, 3.5 inches wide, whose `savefig` writes what Matplotlib can.
    InputError where Matplotlib is asked for and not installed.
    """

    def __init__(self, run: JudgedRun) -> None:
        self._run = run

    def __repr__(self) -> str:
        if self._run.scenario:
            return "<figures: steps(), ship(), errors(), forces()>"
        return "<figures: steps(), signals()>" if self._has_signals else "<figures: steps()>"

    @property
    def _has_signals(self) -> bool:
        """Return whether the run is a closed loop of a `LinearMPC`."""
        return self._run.signals is not None

    def steps(self, *others: JudgedRun, backend: Backend = "altair") -> Any:
        """Plot step time, error of the first move and iterations over the steps.

        Forces too, where it is one closed loop; several runs have a line each.
        """
        from dpbench.analysis.verdict.requirements import Requirements

        run, limit = self._run, Requirements().error_move
        if others:
            return _draw_steps_together((run, *others), limit, backend)
        tables = _make_step_rows(run.steps), _compute_force_shares(run)
        if _is_matplotlib_chosen(backend):
            return _import_matplotlib_charts().draw_step_strips(*tables, limit)
        from dpbench.report.charts.steps import draw_step_strips

        return draw_step_strips(*tables, limit)

    def signals(self, *others: JudgedRun, backend: Backend = "altair") -> Any:
        """Plot outputs with their references, and inputs, of a `LinearMPC` over time.

        Raises InputError for a run without them, or runs with signals of other names.
        """
        from dpbench.report.charts.ship_tables import make_signal_panels

        runs = (self._run, *others)
        names = [_list_signals(run) for run in runs]
        if names.count(names[0]) != len(names):
            found = " and ".join(", ".join(one) for one in names if one != names[0])
            allowed = f"runs with the signals {', '.join(names[0])}"
            raise InputError("plot", "run", f"the signals {found}", allowed)
        laws = [
            replace(law, steps=run.signals)
            for law, run in zip(_convert_to_labelled_curves(runs), runs, strict=True)
        ]
        laws, panels = make_signal_panels(laws)
        if _is_matplotlib_chosen(backend):
            return _import_matplotlib_charts().draw_panels(panels)
        from dpbench.report.charts.ship import draw_signals

        return draw_signals(panels, laws)

    def ship(self, *others: JudgedRun, backend: Backend = "altair") -> Any:
        """Plot the ship's path in the north-east plane with the 1 m circle (Fig. 4 of the paper).

        Raises InputError for a replay, which has no ship, or runs of two starts or setpoints.
        """
        laws, scenario = self._collect_curves_and_scenario(others, START)
        if _is_matplotlib_chosen(backend):
            from dpbench.report.charts.ship_tables import make_path_tables

            return _import_matplotlib_charts().draw_path(make_path_tables(laws, scenario))
        from dpbench.report.charts.ship import draw_path

        return draw_path(laws, scenario)

    def errors(self, *others: JudgedRun, backend: Backend = "altair") -> Any:
        """Plot north, east, heading and radial error of closed loops (Fig. 5 of the paper).

        Raises InputError for a replay, which has no ship, or runs of two setpoints.
        """
        laws, scenario = self._collect_curves_and_scenario(others, SETPOINT)
        if _is_matplotlib_chosen(backend):
            from dpbench.report.charts.ship_tables import make_error_panels

            return _import_matplotlib_charts().draw_panels(make_error_panels(laws, scenario))
        from dpbench.report.charts.ship import draw_pose_errors

        return draw_pose_errors(laws, scenario)

    def forces(self, *others: JudgedRun, backend: Backend = "altair") -> Any:
        """Plot the applied forces of closed loops with their limits (Fig. 6 of the paper).

        Raises InputError for a replay, which has no ship, or runs of two sets of limits.
        """
        laws, scenario = self._collect_curves_and_scenario(others, FORCE_LIMITS)
        if _is_matplotlib_chosen(backend):
            from dpbench.report.charts.ship_tables import make_force_panels

            return _import_matplotlib_charts().draw_panels(make_force_panels(laws, scenario))
        from dpbench.report.charts.ship import draw_forces

        return draw_forces(laws, scenario)

    def _collect_curves_and_scenario(
        self, others: tuple[JudgedRun, ...], shared: SharedData
    ) -> tuple[list[Any], Scenario]:
        """Return the labelled curves of these runs, and a scenario with the shared data."""
        scenario = self._require_shared_data(others, shared)
        return _convert_to_labelled_curves((self._run, *others)), scenario

    def _require_shared_data(self, others: tuple[JudgedRun, ...], shared: SharedData) -> Scenario:
        """Return this run's scenario; InputError if the others' data differ or one has no ship."""
        scenario = self._run.scenario
        for run in (self._run, *others):
            _require_run(run, "`run_closed_loop`")
            if run.scenario is None or scenario is None:
                raise InputError("plot", "run", *_describe_missing_ship(run))
            if shared.read(run.scenario) != shared.read(scenario):
                found = f"{scenario.name} and {run.scenario.name}"
                raise InputError("plot", "run", found, f"closed loops with {shared.name}")
        assert scenario is not None, "of a closed loop"
        return scenario


def _describe_missing_ship(run: JudgedRun) -> tuple[str, str]:
    """Return what was found, and what is allowed, where a figure needs a ship."""
    if run.signals is None:
        return "a replay", "a closed loop; a replay has no ship"
    found = "a closed loop of a custom plant, which has no ship"
    return found, "a ship's closed loop; `run.plot.signals()` plots the plant"


def _list_signals(run: JudgedRun) -> list[str]:
    """Return the columns of a run's signals; InputError for a run without."""
    _require_run(run, "`run_closed_loop`")
    if run.signals is None:
        found = f"{run.label} without signals"
        raise InputError("plot", "run", found, "closed loops of a `LinearMPC`")
    return [*map(str, run.signals)]


class ResultPlots:
    """Plots of a benchmark's results, by Altair or Matplotlib as those of `RunPlots`."""

    def __init__(self, data: PageData) -> None:
        self._data = data

    def __repr__(self) -> str:
        return "<figures: times(), accuracy()>"

    def times(self, *, backend: Backend = "altair") -> Any:
        """Plot each solver's p50, p99, longest step and largest timing against the deadline.

        Raises InputError where no replay was timed.
        """
        from dpbench.analysis.times.solver_tables import tabulate_best_times

        table, limits = _require_rows(tabulate_best_times(self._data)), self._data.requirements
        if _is_matplotlib_chosen(backend):
            draw = _import_matplotlib_charts().draw_deadline_chart
        else:
            from dpbench.report.charts.overview import draw_deadline_chart as draw
        return draw(table, limits.deadline_ms, limits.p99_ms)

    def accuracy(self, *, backend: Backend = "altair") -> Any:
        """Plot the largest error of each solver in the replays over its step time, by settings.

        Raises InputError where no replay was timed.
        """
        from dpbench.analysis.times.solver_tables import tabulate_tolerance_levels

        table, limits = (
            _require_rows(tabulate_tolerance_levels(self._data)),
            self._data.requirements,
        )
        if _is_matplotlib_chosen(backend):
            return _import_matplotlib_charts().draw_accuracy(table, limits.error_move)
        from dpbench.report.charts.overview import draw_accuracy

        return draw_accuracy(table, limits.error_move, with_names=True)


def _require_rows(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of timed solvers, InputError where it has no row."""
    if table.empty:
        raise InputError("plot", "results", "no timed replay", "results of a suite with replays")
    return table


def _is_matplotlib_chosen(backend: str) -> bool:
    """Return whether Matplotlib is to draw; InputError for a backend that is not known."""
    if backend not in (known := get_args(Backend)):
        raise InputError("plot", "backend", repr(backend), f"one of {', '.join(known)}")
    return backend == "matplotlib"


def _import_matplotlib_charts() -> ModuleType:
    """Import what draws by Matplotlib; InputError that names the extra where it is missing."""
    try:
        # What an extra installs is imported only where it is asked for.
        from dpbench.report.charts import printed
    except ModuleNotFoundError as error:
        found = f"matplotlib, but the module {error.name} is not installed"
        allowed = "altair; or matplotlib after `pip install 'dpbench[matplotlib]'`"
        raise InputError("plot", "backend", found, allowed) from error
    return printed


def _require_run(run: object, makers: str) -> None:
    """Raise TypeError for what is no run; `makers` names the functions that return one."""
    if not hasattr(run, "scenario"):
        raise TypeError(f"plot: found {shorten_found(run)}; allowed: runs of {makers}")


def _draw_steps_together(runs: tuple[JudgedRun, ...], limit: float, backend: Backend) -> Any:
    """Plot the steps of several runs with the limit on their errors."""
    for run in runs:
        _require_run(run, "`run_closed_loop` and `replay`")
    laws = [
        replace(law, steps=_make_step_rows(law.steps)) for law in _convert_to_labelled_curves(runs)
    ]
    if _is_matplotlib_chosen(backend):
        from dpbench.report.charts.ship_tables import STEP, make_step_panels

        return _import_matplotlib_charts().draw_panels(make_step_panels(laws, limit), STEP)
    from dpbench.report.charts.ship import draw_steps_together

    return draw_steps_together(laws, limit)


def _convert_to_labelled_curves(runs: tuple[JudgedRun, ...]) -> list[Any]:
    """Convert runs to labelled curves of a plot; name or number the cases of those alike.

    Solver and mode are left out where all runs have the same.
    """
    from dpbench.analysis.suites.paper import Law
    from dpbench.report.formats import drop_shared_options

    names = drop_shared_options([run.label for run in runs])
    cases = [run.case_text for run in runs]
    if len({case.rpartition(" ")[0] for case in cases}) == 1:  # one mode
        cases = [case.rpartition(" ")[2] for case in cases]
    solver = "" if len(set(names)) == 1 else "{} in "
    names = [
        f"{solver.format(name)}{case}" if names.count(name) > 1 and len(set(cases)) > 1 else name
        for name, case in zip(names, cases, strict=True)
    ]
    labels = [
        name if names.count(name) == 1 else f"{name} #{names[:i].count(name) + 1}"
        for i, name in enumerate(names)
    ]
    return [Law(label, run.steps) for label, run in zip(labels, runs, strict=True)]


def _make_step_rows(steps: pd.DataFrame) -> pd.DataFrame:
    """Return time [µs], error, iterations and active limits of each step, for a plot."""
    from dpbench.analysis.records.run_steps import extract_counting_rows, yield_merged_steps_by_run
    from dpbench.report.charts.steps import NO_ANSWER

    ((_, run),) = yield_merged_steps_by_run(extract_counting_rows(steps))
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


def _compute_force_shares(run: JudgedRun) -> pd.DataFrame | None:
    """Return a closed loop's hull forces as shares of limits, by step; None for a replay."""
    from dpbench.analysis.records.thinned_runs import FORCES as COLUMNS
    from dpbench.bench.record.schema import FORCES

    if run.scenario is None:
        return None
    vessel = run.scenario.vessel
    limits = np.maximum(vessel.tau_max, -vessel.tau_min)
    tables = [
        pd.DataFrame({"k": run.steps["k"], "force": force, "share": run.steps[column] / limit})
        for force, column, limit in zip(FORCES, COLUMNS, limits, strict=True)
    ]
    return pd.concat(tables)

"""Tables of the figures of a ship, or of steps, in several runs, as either backend draws them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from dpbench.analysis.records.thinned_runs import MOST, find_extreme_indices
from dpbench.analysis.suites.paper import CIRCLE_M, Law, compute_pose_errors
from dpbench.arrays import Vector
from dpbench.report.charts import style
from dpbench.scenario.scenario import Scenario

CORNERS = 73
"""Corners of the polygon of a circle: every 5°, the first again at the end."""
DRAWN_FORCES = (
    ("surge", "x", "N", 1e3, "kN"),
    ("sway", "y", "N", 1e3, "kN"),
    ("yaw", "n", "Nm", 1e6, "MN·m"),
)
TIME, STEP = "t [s]", "step k"
"""Names of the axis that panels share."""
MOST_TOGETHER = 4800
"""Points of all runs in a figure: a notebook refuses tables of more than 5000 rows."""
LEAST_M = 1e-6
"""Smallest radial error drawn [m]: a logarithmic axis has no zero."""


@dataclass(frozen=True, eq=False)
class PathTables:
    """North-east paths of the ship with the 1 m circle, start and reference.

    lines : columns law, i, n and e [m]. circle : columns i, n and e. marks : n, e and what.
    """

    lines: pd.DataFrame
    circle: pd.DataFrame
    marks: pd.DataFrame

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Limits of the axes `n` and `e` [m], equally long and around all points."""
        table = pd.concat([self.lines, self.circle, self.marks])
        half = 0.54 * max(table[a].max() - table[a].min() for a in ("n", "e"))
        middle = {a: 0.5 * (table[a].min() + table[a].max()) for a in ("n", "e")}
        return {a: (middle[a] - half, middle[a] + half) for a in middle}


@dataclass(frozen=True, eq=False)
class Panel:
    """One quantity over time, or over the steps, under each control law.

    table : columns law, t (time [s] or step) and value. limits : drawn across. note : words in the
    corner.
    """

    title: str
    table: pd.DataFrame
    limits: tuple[float, ...] = ()
    note: str = ""
    is_log: bool = False


def make_path_tables(laws: Sequence[Law], scenario: Scenario) -> PathTables:
    """Return tables of the ship's path under each control law, thinned for drawing."""
    tables = []
    for law in laws:
        thin = law.steps.iloc[:: len(law.steps) // _count_points_per_run(laws) + 1]
        places = {"i": range(len(thin)), "n": thin["n_m"], "e": thin["e_m"]}
        tables.append(pd.DataFrame({"law": law.label, **places}))
    north, east = (float(x) for x in scenario.reference[:2])
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS)
    n, e = north + CIRCLE_M * np.cos(angle), east + CIRCLE_M * np.sin(angle)
    circle = pd.DataFrame({"i": range(CORNERS), "n": n, "e": e})
    marks = pd.DataFrame([[*map(float, scenario.start[:2])], [north, east]], columns=["n", "e"])
    return PathTables(pd.concat(tables), circle, marks.assign(what=["start", "reference"]))


def make_error_panels(laws: Sequence[Law], scenario: Scenario) -> list[Panel]:
    """Return panels of north, east, heading and radial error over time under each control law."""
    panels = []
    for name, unit in (("north", "m"), ("east", "m"), ("heading", "°"), ("radial", "m")):
        table = _tabulate_by_law_over_time(
            laws, lambda law, name=name: compute_pose_errors(law.steps, scenario.reference)[name]
        )
        is_log = name == "radial"
        if is_log:
            table["value"] = table["value"].clip(lower=LEAST_M)
        limits = (CIRCLE_M,) if is_log else ()
        panels.append(Panel(f"{name} [{unit}]", table, limits, is_log=is_log))
    return panels


def make_force_panels(laws: Sequence[Law], scenario: Scenario) -> list[Panel]:
    """Return panels of the applied force in each axis over time, with its limits."""
    return _make_axis_panels(laws, "tau", "", scenario.vessel.tau_min, scenario.vessel.tau_max)


def make_increment_panels(laws: Sequence[Law], scenario: Scenario) -> list[Panel]:
    """Return panels of the change of force in each step over time, with the rate limits."""
    most = scenario.force_step_max
    return _make_axis_panels(laws, "dtau", "Δ", -most, most)


def make_step_panels(runs: Sequence[Law], error_limit: float) -> list[Panel]:
    """Return panels of step time, error of the first move and iterations over runs' steps.

    runs : with steps of the columns `charts.steps.COLUMNS`.
    """
    panels = []
    for column, title, limits in (
        ("time_us", "time [µs]", ()),
        ("error", "error of the\nfirst move", (error_limit,)),
        ("iterations", "iterations", ()),
    ):
        table = _tabulate_by_law_over_time(runs, lambda run, c=column: run.steps[c], over="k")
        is_log = column != "iterations"
        if is_log:
            table["value"] = table["value"].clip(lower=style.FLOOR)
        panels.append(Panel(title, table, limits, is_log=is_log))
    return panels


def make_signal_panels(runs: Sequence[Law]) -> tuple[list[Law], list[Panel]]:
    """Return the curves, with the reference last, and panels of outputs and inputs over time.

    runs : with steps of the columns t_s, each output, `<output>_reference`, and each input.
    """
    table = runs[0].steps
    outputs = {f"{name}_reference": name for name in table if f"{name}_reference" in table}
    reference = Law("reference", table[["t_s", *outputs]].rename(columns=outputs))
    panels = []
    for name in table.columns.drop(["t_s", *outputs]):
        # Last: colours follow the order of the curves, also where a panel has no reference.
        drawn = [*runs, *([reference] if name in reference.steps else ())]
        values = _tabulate_by_law_over_time(drawn, lambda law, n=name: law.steps[n])
        panels.append(Panel(str(name), values))
    return [*runs, reference], panels


def _make_axis_panels(
    laws: Sequence[Law], column: str, sign: str, low: Vector, high: Vector
) -> list[Panel]:
    """Return a panel per axis: force, or its change a step, over time; with limits or a note."""
    panels = []
    for (name, key, unit, scale, shown), *limits in zip(DRAWN_FORCES, low, high, strict=True):
        field = f"{column}_{key}_{unit}"
        table = _tabulate_by_law_over_time(
            laws, lambda law, f=field, s=scale: law.steps[f].to_numpy() / s
        )
        reach = float(np.abs(table["value"]).max())
        near = [limit / scale for limit in limits if abs(limit / scale) <= 2.5 * max(reach, 1e-12)]
        # Limits far off are named, as a figure without them looks as if there were none.
        far = "" if near else f"limits {_format_range(*(one / scale for one in limits))}"
        panels.append(Panel(f"{sign}{name} [{shown}]", table, tuple(near), far))
    return panels


def _format_range(low: float, high: float) -> str:
    """Return two limits as text: ±high where they are symmetric, else both."""
    if np.isclose(low, -high):
        return f"±{high:.4g}"
    return f"{low:+.4g} to {high:+.4g}".replace("-", "−")


def _tabulate_by_law_over_time(
    laws: Sequence[Law], value: Callable[..., npt.ArrayLike | pd.Series], over: str = "t_s"
) -> pd.DataFrame:
    """Return a table of a quantity by control law over the column `over`, thinned for drawing."""
    tables = []
    for law in laws:
        values, t = np.asarray(value(law), dtype=np.float64), law.steps[over].to_numpy()
        shown = find_extreme_indices(values, _count_points_per_run(laws))
        tables.append(pd.DataFrame({"law": law.label, "t": t[shown], "value": values[shown]}))
    return pd.concat(tables)


def _count_points_per_run(laws: Sequence[Law]) -> int:
    """Return the largest number of points drawn of each of several runs."""
    return min(MOST, MOST_TOGETHER // len(laws))

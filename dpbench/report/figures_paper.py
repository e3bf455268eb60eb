"""Figures 4-7 of the paper, drawn from the rows: the constrained law against the clipped one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dpbench.analysis.records import Records
from dpbench.report.reproduced import CIRCLE_M, pair_of
from dpbench.report.style import CLIPPED, CONSTRAINED, GREY, LIMIT, log_y, new_figure, one_axes
from dpbench.scenario.scenario import Scenario

AXES = (
    ("surge", "x", "N", 1e3, "kN"),
    ("sway", "y", "N", 1e3, "kN"),
    ("yaw", "n", "Nm", 1e6, "MN·m"),
)


@dataclass(frozen=True, eq=False)
class Law:
    """One control law's run: how it is drawn, and its rows."""

    label: str
    colour: str
    dashes: str
    steps: pd.DataFrame


def laws_of(view: Records, scenario: str) -> list[Law]:
    """The laws of a scenario that have a complete run; the dashed one last, so both are seen."""
    pair = pair_of(view, scenario)
    laws = []
    if pair.constrained is not None:
        label = f"constrained ({pair.constrained.solver})"
        laws.append(Law(label, CONSTRAINED, "-", view.steps(pair.constrained)))
    if pair.clipped is not None:
        laws.append(Law("unconstrained, clipped", CLIPPED, "--", view.steps(pair.clipped)))
    return laws


def trajectory(laws: Sequence[Law], scenario: Scenario) -> Figure:
    """Figure 4: the ship's path in the north-east plane with the 1 m precision circle."""
    figure, ax = one_axes(5.6, 5.2)
    draw_path(ax, laws, scenario)
    legend_below(figure, ax, columns=2)
    return figure


def draw_path(ax: Axes, laws: Sequence[Law], scenario: Scenario) -> None:
    """The paths with start, set-point and precision circle."""
    north, east = scenario.reference[:2]
    circle = Circle((east, north), CIRCLE_M, fill=False, color=LIMIT, lw=1, ls=":")
    ax.add_patch(circle)
    ax.plot([], [], color=LIMIT, lw=1, ls=":", label="1 m circle")
    for law in laws:
        ax.plot(law.steps["e_m"], law.steps["n_m"], law.dashes, color=law.colour, label=law.label)
    ax.plot(scenario.start[1], scenario.start[0], "o", color=LIMIT, ms=5, label="start")
    ax.plot(east, north, "+", color=LIMIT, ms=9, label="set-point")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")


def precision(laws: Sequence[Law], scenario: Scenario) -> Figure:
    """Figure 5: north, east and heading error and the radial error against time."""
    figure = new_figure(8.2, 6.4)
    axes = figure.subplots(4, 1, sharex=True)
    goal = scenario.reference
    for law in laws:
        for ax, values in zip(axes, errors(law, goal), strict=True):
            draw_line(ax, law, values)
    for ax, label in zip(axes, ("north [m]", "east [m]", "heading [°]", "radial [m]"), strict=True):
        ax.set_ylabel(label)
    log_y(axes[3])
    axes[3].axhline(CIRCLE_M, color=LIMIT, ls=":", lw=1)
    return _finish(figure, axes, laws, scenario)


def errors(law: Law, goal: np.ndarray) -> tuple[np.ndarray, ...]:
    """North, east [m], heading [°] and radial error [m] of a law."""
    n = law.steps["n_m"].to_numpy() - goal[0]
    e = law.steps["e_m"].to_numpy() - goal[1]
    psi = np.degrees(law.steps["psi_rad"].to_numpy() - goal[2])
    # A zero has no place on a log axis; a micrometre is below anything of interest.
    return n, e, psi, np.maximum(np.hypot(n, e), 1e-6)


def forces(laws: Sequence[Law], scenario: Scenario) -> Figure:
    """Figure 6: the force applied in each axis with its amplitude limits, and the command."""
    figure = new_figure(8.2, 5.6)
    axes = figure.subplots(3, 1, sharex=True)
    for i, (ax, (name, key, unit, scale, shown)) in enumerate(zip(axes, AXES, strict=True)):
        for law in laws:
            draw_line(ax, law, law.steps[f"tau_{key}_{unit}"].to_numpy() / scale)
        low, high = scenario.vessel.tau_min[i] / scale, scenario.vessel.tau_max[i] / scale
        draw_limits(ax, low, high)
        ax.set_ylabel(f"{name} [{shown}]")
    return _finish(figure, axes, laws, scenario)


def increments(laws: Sequence[Law], scenario: Scenario) -> Figure:
    """Figure 7: the change of the force in each step with the rate limits."""
    figure = new_figure(8.2, 5.6)
    axes = figure.subplots(3, 1, sharex=True)
    for i, (ax, (name, key, unit, scale, shown)) in enumerate(zip(axes, AXES, strict=True)):
        for law in laws:
            draw_line(ax, law, law.steps[f"dtau_{key}_{unit}"].to_numpy() / scale)
        limit = scenario.du_max[i] / scale
        draw_limits(ax, -limit, limit)
        ax.set_ylabel(f"Δ{name} [{shown}]")
    return _finish(figure, axes, laws, scenario)


def simulated_s(laws: Sequence[Law], scenario: Scenario) -> float:
    """How long the longest of the runs lasted [s]."""
    return max(len(law.steps) for law in laws) * scenario.sample_s


def draw_line(ax: Axes, law: Law, values: np.ndarray) -> None:
    """One quantity of a law against time, held over each sample."""
    ax.step(
        law.steps["t_s"],
        values,
        law.dashes,
        color=law.colour,
        where="post",
        label=law.label,
        lw=1.1,
    )


def draw_limits(ax: Axes, low: float, high: float) -> None:
    """Limits as dashed lines, when the data come near enough for them to matter."""
    bottom, top = ax.get_ylim()
    reach = max(abs(bottom), abs(top))
    near = [limit for limit in (low, high) if abs(limit) <= 2.5 * reach]
    for limit in near:
        ax.axhline(limit, color=LIMIT, ls=(0, (5, 3)), lw=0.9)
    if not near:
        ax.set_title(
            f"limits {low:.4g} and {high:.4g} lie outside".replace("-", "−"),
            loc="right",
            fontsize=7.5,
            fontweight="normal",
            color=GREY,
            pad=2,
        )


def _finish(
    figure: Figure, axes: Sequence[Axes], laws: Sequence[Law], scenario: Scenario
) -> Figure:
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0, simulated_s(laws, scenario))
    figure.align_ylabels(list(axes))
    legend_below(figure, axes[0], columns=3)
    return figure


def legend_below(figure: Figure, ax: Axes, columns: int) -> None:
    """The legend of some axes below the whole figure."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)

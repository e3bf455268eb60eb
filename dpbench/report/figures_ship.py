"""The ship in one figure: path, errors, forces and their increments with the limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dpbench.report.figures_paper import (
    AXES,
    Law,
    draw_limits,
    draw_line,
    draw_path,
    errors,
    legend_below,
    simulated_s,
)
from dpbench.report.reproduced import CIRCLE_M
from dpbench.report.style import LIMIT, log_y, new_figure
from dpbench.scenario.scenario import Scenario

COLUMNS = ("error", "force", "change")
PLACES: dict[str, tuple[int | slice, int]] = {
    "path": (slice(0, 2), 0),
    "radius": (2, 0),
    **{f"{name}{i}": (i, j + 1) for i in range(3) for j, name in enumerate(COLUMNS)},
}
"""RunRecord and column of each panel."""


def ship(laws: Sequence[Law], scenario: Scenario) -> Figure:
    """What the laws did to the ship: path and radius, errors, forces, increments by axis."""
    figure = new_figure(12.0, 6.6)
    grid = figure.add_gridspec(3, 4, width_ratios=[1.3, 1.0, 1.0, 1.0])
    panels = {name: figure.add_subplot(grid[where]) for name, where in PLACES.items()}
    draw_path(panels["path"], laws, scenario)
    _errors(panels, laws, scenario)
    for i in range(len(AXES)):
        _axis(panels, i, laws, scenario)
    for name, ax in panels.items():
        if name != "path":
            ax.set_xlim(0, simulated_s(laws, scenario))
    for name in ("radius", "error2", "force2", "change2"):
        panels[name].set_xlabel("time [s]")
    legend_below(figure, panels["path"], columns=5)
    return figure


def _errors(panels: dict[str, Axes], laws: Sequence[Law], scenario: Scenario) -> None:
    names = {"error0": "north", "error1": "east", "error2": "heading", "radius": "radius"}
    for law in laws:
        for name, values in zip(names, errors(law, scenario.reference), strict=True):
            draw_line(panels[name], law, values)
    for name, shown in names.items():
        panels[name].set_ylabel(f"{shown} [{'°' if shown == 'heading' else 'm'}]")
    log_y(panels["radius"])
    panels["radius"].axhline(CIRCLE_M, color=LIMIT, ls=":", lw=1)


def _axis(panels: dict[str, Axes], i: int, laws: Sequence[Law], scenario: Scenario) -> None:
    """Force and increment of one axis with their limits."""
    name, key, unit, scale, shown = AXES[i]
    force, change = panels[f"force{i}"], panels[f"change{i}"]
    for law in laws:
        draw_line(force, law, law.steps[f"tau_{key}_{unit}"].to_numpy() / scale)
        draw_line(change, law, law.steps[f"dtau_{key}_{unit}"].to_numpy() / scale)
    vessel, rate = scenario.vessel, scenario.du_max[i] / scale
    if scenario.faults:
        _draw_limits_of_the_time(force, laws, scenario, i, scale)
    else:
        draw_limits(force, vessel.tau_min[i] / scale, vessel.tau_max[i] / scale)
    draw_limits(change, -rate, rate)
    force.set_ylabel(f"{name} [{shown}]")
    change.set_ylabel(f"Δ{name} [{shown}]")


def _draw_limits_of_the_time(
    ax: Axes, laws: Sequence[Law], scenario: Scenario, i: int, scale: float
) -> None:
    """Amplitude limits that a fault changes, as dashed steps; the axis still fits the data."""
    shown = ax.get_ylim()
    samples = round(simulated_s(laws, scenario) / scenario.sample_s)
    t_s = np.arange(samples) * scenario.sample_s
    for limit in scenario.limit_tables(samples):
        ax.step(t_s, limit[:, i] / scale, color=LIMIT, ls=(0, (5, 3)), lw=0.9, where="post")
    reach = 2.5 * max(abs(end) for end in shown)
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, -reach), min(high, reach))

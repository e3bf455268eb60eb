"""Picture of the statement: offset, heading error and thrust of a closed loop, as plain SVG."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.thinned_runs import find_extreme_indices
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.arrays import Vector
from dpbench.bench.run.exact_loop import HEADING_DEG
from dpbench.report.charts.style import ACCENT, FAIL, INK, SOFT
from dpbench.report.formats import join_with_and, significant
from dpbench.report.page.data import PageData

POINTS = 150  # Corners of a line, at most: one a point of a page
GAP = 24.0  # Space between panels [points]
SAME_M = 1e-3
"""Distance from the reference loop below which a loop ends where that does [m]."""
BEFORE_LOSS_S = 60.0
"""Time before the first loss at which a picture of it begins [s]."""


@dataclass(frozen=True)
class Panel:
    """Curve of a picture: its name, unit, values (K,), and the limit of the station or None."""

    name: str
    unit: str
    values: Vector
    limit: float | None = None

    @property
    def most(self) -> float:
        """Value at the upper edge of the panel."""
        return 1.1 * max(float(self.values.max()), 1e-9)


@dataclass(frozen=True)
class LoopPicture:
    """Offset, heading error and thrust of a closed loop at the times (K,) [s], side by side."""

    run: RunRecord
    t_s: Vector
    panels: tuple[Panel, ...]

    @property
    def caption(self) -> str:
        """Caption of the picture, in two sentences."""
        run = self.run
        names = join_with_and([panel.name for panel in self.panels]).capitalize()
        around = (
            f" around the loss of {join_with_and(losses[0][1])}" if (losses := self._losses) else ""
        )
        return (
            f"{names}{around} in {run.scenario}, {significant(self.t_s[0])} to "
            f"{significant(self.t_s[-1])} s, with {run.solver}: at most "
            f"{significant(run.dev_position_max_m)} m from the reference loop. Dashed, "
            f"if reached: limits of the station, {run.station_radius_m:.3g} m and {HEADING_DEG:g}°."
        )

    @property
    def _losses(self) -> list[tuple[float, list[str]]]:
        """Times [s] and names of the losses within the picture."""
        return [loss for loss in list_losses(self.run) if loss[0] <= self.t_s[-1]]

    def svg(self, left: float, top: float, width: float, height: float) -> Iterator[str]:
        """Yield the SVG elements of the picture in a box of the page [points]."""
        wide = (width - GAP * (len(self.panels) - 1)) / len(self.panels)
        lefts = [left + number * (wide + GAP) for number in range(len(self.panels))]
        for panel, at in zip(self.panels, lefts, strict=True):
            gap = "" if panel.unit == "°" else " "
            at_most = int(panel.values.argmax())
            most = f"{significant(panel.values[at_most])}{gap}{panel.unit}"
            title = f"largest {panel.name} {most} ({significant(self.t_s[at_most])} s)"
            yield _make_svg_label(at, top - 2.0, title)
        for panel, at in zip(self.panels, lefts, strict=True):
            yield from self._yield_panel_svg(panel, at, top, wide, height)

    def _yield_panel_svg(
        self, panel: Panel, left: float, top: float, width: float, height: float
    ) -> Iterator[str]:
        """Yield the SVG elements of one panel, with losses as vertical lines."""
        shown = find_extreme_indices(panel.values, POINTS)
        most = panel.most
        begins_s, lasts_s = self.t_s[0], max(float(self.t_s[-1] - self.t_s[0]), 1e-9)
        x = left + width * (self.t_s[shown] - begins_s) / lasts_s
        y = top + height * (1.0 - panel.values[shown] / most)
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        if panel.limit is not None and panel.limit < most:
            at = top + height * (1.0 - panel.limit / most)
            yield (
                f'<line x1="{left:.1f}" x2="{left + width:.1f}" y1="{at:.1f}" y2="{at:.1f}" '
                f'stroke="{FAIL}" stroke-dasharray="4 3"/>'
            )
        for at_s, lost in self._losses:
            at = left + width * (at_s - begins_s) / lasts_s
            yield f'<path d="M{at:.1f} {top}v{height}" stroke="{FAIL}" stroke-width="0.8"/>'
            yield _make_svg_label(at, top + 7.0, f"loss of {escape(join_with_and(lost))}")
        yield (
            f'<path d="M{left:.1f} {top}v{height}h{width:.1f}" fill="none" stroke="{SOFT}"/>'
            f'<polyline points="{line}" fill="none" stroke="{ACCENT}" stroke-width="1.2"/>'
        )


def _make_svg_label(x: float, y: float, text: str) -> str:
    """Return a small SVG text at a point (x, y) of the picture."""
    return f'<text x="{x + 3.0:.1f}" y="{y:.1f}" font-size="7" fill="{INK}">{text}</text>'


def find_loop_picture(data: PageData, solver: str) -> LoopPicture | None:
    """Return a picture of a solver's loop with a loss, or of the farthest ship; None without loop.

    None without steps.
    """
    loops = [
        run
        for run in data.records.select_runs(mode="closed_loop", solver=solver, units="scaled")
        if run.has_steps and data.build_scenario_of_run(run) is not None and run.exact_steps > 0.0
    ]
    if not loops or not data.records.has_steps:
        return None
    run = max(loops, key=lambda run: (_find_begin_s(run) > 0.0, _compute_offset_share(run)))
    scenario = data.build_scenario_of_run(run)
    assert scenario is not None, "chosen so"
    columns = ("k", "n_m", "e_m", "psi_rad", "thrust_share")
    steps = data.records.read_counting_step_table(run, columns)
    steps = steps[steps["k"] * scenario.sample_s >= _find_begin_s(run)]
    wanted = scenario.build_reference_table(int(steps["k"].max()) + 1)[steps["k"]]
    north, east, turn = (
        steps[name].to_numpy() - wanted[:, i] for i, name in enumerate(("n_m", "e_m", "psi_rad"))
    )
    offset_m, heading_deg = np.hypot(north, east), np.degrees(np.abs(turn))
    thrust, t_s = 100.0 * steps["thrust_share"].to_numpy(), steps["k"].to_numpy() * run.sample_s
    if run.steps_done == run.exact_steps and run.dev_position_max_m < SAME_M:
        # The steps have the state at their start: the end is that of the reference loop.
        offset_m = np.append(offset_m, run.exact_offset_end_m)
        heading_deg = np.append(heading_deg, run.exact_heading_end_deg)
        thrust, t_s = np.append(thrust, thrust[-1]), np.append(t_s, run.steps_done * run.sample_s)
    panels = [
        Panel("offset", "m", offset_m, run.station_radius_m),
        Panel("heading error", "°", heading_deg, HEADING_DEG),
    ]
    if np.isfinite(thrust).all():
        panels.append(Panel("thrust", "% of all", thrust))
    return LoopPicture(run, t_s, tuple(panels))


def _find_begin_s(run: RunRecord) -> float:
    """Return the time [s] at which a picture of a run begins: short before a loss, or 0."""
    lost_s = [at_s for at_s, _ in list_losses(run) if at_s < run.steps_done * run.sample_s]
    return max(0.0, min(lost_s) - BEFORE_LOSS_S) if lost_s else 0.0


def _compute_offset_share(run: RunRecord) -> float:
    """Return a run's largest offset, after its loss if it has one, in multiples of its station."""
    after_loss_m = run.exact_loss_offset_max_m
    most_m = run.exact_offset_max_m if math.isnan(after_loss_m) else after_loss_m
    return most_m / run.station_radius_m

"""Picture of the statement: the ship's offset from its setpoint over time, as plain SVG."""

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

import numpy as np

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.thinned_runs import extreme_indices
from dpbench.arrays import Vector
from dpbench.report.charts.style import ACCENT, FAIL, INK, SOFT
from dpbench.report.formats import and_list, significant
from dpbench.report.page.data import PageData
from dpbench.report.ship_text import list_losses

POINTS = 300  # Corners of the line, at most: one every 1.7 points of a page


@dataclass(frozen=True)
class OffsetPicture:
    """Offsets (K,) [m] of a closed loop from its setpoint at the times (K,) [s]."""

    run: RunRecord
    t_s: Vector
    offset_m: Vector

    @property
    def caption(self) -> str:
        """Caption of the picture of the ship's offset, one sentence."""
        run = self.run
        dashed = " (dashed)" if self.offset_m.max() > run.station_radius_m else ""
        return (
            f"Offset from the setpoint in {run.scenario}, with {run.solver}: at most "
            f"{significant(run.dev_position_max_m)} m from the exactly solved loop. Its station "
            f"ends at {run.station_radius_m:.3g} m{dashed}."
        )

    def svg(self, left: float, top: float, width: float, height: float) -> Iterator[str]:
        """Yield the SVG elements of the picture in a box of the page [points]."""
        most = 1.1 * max(float(self.offset_m.max()), 1e-9)
        x = left + width * self.t_s / max(float(self.t_s[-1]), 1e-9)
        y = top + height * (1.0 - self.offset_m / most)
        limit = top + height * (1.0 - self.run.station_radius_m / most)
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        yield _svg_label(left, top + 7.0, f"{significant(most)} m")
        if limit > top:
            yield (
                f'<line x1="{left}" x2="{left + width}" y1="{limit:.1f}" y2="{limit:.1f}" '
                f'stroke="{FAIL}" stroke-dasharray="4 3"/>'
            )
        yield (
            f'<path d="M{left} {top}v{height}h{width}" fill="none" stroke="{SOFT}"/>'
            f'<polyline points="{line}" fill="none" stroke="{ACCENT}" stroke-width="1.2"/>'
        )
        for at_s, lost in list_losses(self.run):
            at = left + width * at_s / max(float(self.t_s[-1]), 1e-9)
            if at <= left + width:
                yield f'<path d="M{at:.1f} {top}v{height}" stroke="{FAIL}" stroke-width="0.8"/>'
                yield _svg_label(at, top + 7.0, f"loss of {escape(and_list(lost))}")
        yield _svg_label(left + width - 40.0, top + height - 3.0, f"{significant(self.t_s[-1])} s")


def _svg_label(x: float, y: float, text: str) -> str:
    """Return a small SVG text at a point (x, y) of the picture."""
    return f'<text x="{x + 3.0:.1f}" y="{y:.1f}" font-size="7" fill="{INK}">{text}</text>'


def find_offset_picture(data: PageData, solver: str) -> OffsetPicture | None:
    """Return the picture of a solver's loop whose ship goes farthest; None without steps."""
    loops = [
        run
        for run in data.records.select(mode="closed_loop", solver=solver, units="scaled")
        if run.has_steps and data.scenario(run) is not None and run.exact_steps > 0.0
    ]
    if not loops or not data.records.has_steps:
        return None
    run = max(loops, key=lambda run: run.exact_offset_max_m / run.station_radius_m)
    scenario = data.scenario(run)
    assert scenario is not None, "chosen so"
    steps = data.records.counting_steps(run, ("k", "n_m", "e_m"))
    wanted = scenario.build_reference_table(int(steps["k"].max()) + 1)[steps["k"]]
    north, east = (steps[name].to_numpy() - wanted[:, i] for i, name in enumerate(("n_m", "e_m")))
    offset_m = np.hypot(north, east)
    shown = extreme_indices(offset_m, POINTS)
    return OffsetPicture(run, steps["k"].to_numpy()[shown] * scenario.sample_s, offset_m[shown])

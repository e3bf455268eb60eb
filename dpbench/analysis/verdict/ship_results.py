"""Results of the controller itself: the ship of each scenario in the reference loop.

A ship that leaves its station there is lost with every solver: none does better than right answers
in every step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, ThrusterUse, group_by_key
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.capability.mean_load import find_overload
from dpbench.bench.run.exact_loop import HEADING_DEG, RADIUS_M
from dpbench.scenario.stability import find_unstable_radius

ShipState = Literal["on station", "leaves", "leaves and returns", "not arrived", "not run"]
"""Result for the ship: it stays on its station, leaves it, leaves it and is within its limits at
the end, has not reached its setpoint, or there is no such loop."""

END_SHARE = 0.9
"""A ship is moving away if its largest offset lies in the rest of the run behind this share of it,
and it ends at least at this share of it."""
NOTICED_SHARE = 0.1
"""Share of the station below which an offset is no sign of moving away."""
SETTLED_SHARE = 0.02
"""Share of the station below which an offset that grows counts as settled."""
FARTHER = 2.0
"""Multiple of the reference loop's largest offset beyond which another loop's ship is named."""


@dataclass(frozen=True)
class ShipResult:
    """Ship of one scenario, or of one sea of a study, controlled by certified optima.

    name : the scenario, with the horizons where it has several; run : one that has the columns
    `exact_*` of its reference loop; loops : all closed loops with it.
    """

    name: str
    run: RunRecord
    loops: tuple[RunRecord, ...] = ()

    @property
    def state(self) -> ShipState:
        """State of the ship: on station, leaving it, not arrived yet, or not run."""
        if not self.run.exact_steps > 0.0:
            return "not run"
        if self.has_left_station:
            return "leaves and returns" if self.is_inside_at_end else "leaves"
        return "on station" if self.is_inside_at_end else "not arrived"

    @property
    def has_left_station(self) -> bool:
        """True if the ship leaves its station, be it back at the end or not."""
        return self.run.exact_steps > 0.0 and not math.isnan(self.run.exact_left_s)

    @property
    def is_lost_at_start(self) -> bool:
        """True if the ship starts off its station and ends farther away."""
        return self.run.exact_left_s == 0.0

    @property
    def unstable_radius(self) -> float:
        """Largest |λ| of a loop that is unstable without limits (paper eq. 35), else NaN."""
        files = self.run.scenario_documents
        return math.nan if files is None else find_unstable_radius(files)

    @property
    def overload(self) -> float:
        """Share of its thrust that the mean load takes of a ship that leaves in time, else NaN.

        A run that ends early shows such a ship on station. NaN for the seas of a study.
        """
        files = self.run.scenario_documents
        is_known = files is not None and not self.run.study and self.state != "not run"
        return find_overload(files) if files is not None and is_known else math.nan

    @property
    def is_held(self) -> bool:
        """True if the ship is on station and its thrust balances the mean load."""
        return self.state == "on station" and math.isnan(self.overload)

    @property
    def used_share_of_station_limits(self) -> float:
        """Largest offset or heading error in multiples of the limits of the station."""
        offset = self.run.exact_offset_max_m / self.run.station_radius_m
        return max(offset, self.run.exact_heading_max_deg / HEADING_DEG)

    @property
    def farther_loop(self) -> RunRecord | None:
        """Closed loop whose ship goes farthest off its station, much farther than here.

        An accurate one where there is any.
        """
        run = self.run
        reach_m = np.nanmax([run.exact_offset_max_m, run.exact_transfer_offset_max_m, 0.0])
        limit_m = max(FARTHER * reach_m, run.station_radius_m)
        far = [loop for loop in self.loops if loop.r_max_m > limit_m]
        return max(far, key=lambda loop: (is_accurate_loop(loop), loop.r_max_m), default=None)

    @property
    def thruster_use(self) -> ThrusterUse | None:
        """Use of the thrusters in the reference loop; None where none are commanded."""
        return next(filter(None, (loop.thruster_use for loop in self.loops)), None)

    @property
    def has_transfer(self) -> bool:
        """True if the ship moves to a setpoint beyond the limits of its station, and arrives."""
        if math.isnan(self.run.exact_offset_rise_m):
            # Folders of earlier releases have no columns on transfers.
            return _is_sent_to_another_position(self.run) and self.state == "on station"
        return not math.isnan(self.run.exact_transfer_s)

    @property
    def is_moving_away(self) -> bool:
        """True if the run ends at or near the ship's largest offset, and that is no small one."""
        largest_m = self.run.exact_offset_max_m
        is_noticed = largest_m >= NOTICED_SHARE * self.run.station_radius_m
        return is_noticed and self._is_growing_to(largest_m)

    @property
    def has_undamped_swing(self) -> bool:
        """True if the ship still swings at the end as far as since a loss, and that is noticed."""
        return self.run.exact_loss_swing_m >= NOTICED_SHARE * self.run.station_radius_m

    @property
    def is_unsettled(self) -> bool:
        """True if the offset grows until the end of the run, after a loss to its largest since.

        True also for an undamped swing.
        """
        after_loss_m = self.run.exact_loss_offset_max_m
        largest_m = self.run.exact_offset_max_m if math.isnan(after_loss_m) else after_loss_m
        is_noticed = largest_m >= SETTLED_SHARE * self.run.station_radius_m
        return self.has_undamped_swing or (is_noticed and self._is_growing_to(largest_m))

    def _is_growing_to(self, largest_m: float) -> bool:
        """Return whether a run ends near its largest offset, which lies late, and moving outward.

        largest_m : of the whole run, or since a loss.
        """
        run = self.run
        # The time of the largest offset is known only where none before a loss is larger.
        was_larger = run.exact_offset_max_m > largest_m
        end_s = run.exact_steps * run.sample_s
        is_late = was_larger or run.exact_offset_max_s >= END_SHARE * end_s
        # Folders of earlier releases have no trend.
        is_outward = not run.exact_offset_rise_m <= 0.0
        return is_late and is_outward and run.exact_offset_end_m >= END_SHARE * largest_m

    @property
    def is_inside_at_end(self) -> bool:
        """True if the ship is within the limits of its station at the end."""
        run = self.run
        is_near = run.exact_offset_end_m <= run.station_radius_m
        return is_near and run.exact_heading_end_deg <= HEADING_DEG


def is_accurate_loop(loop: RunRecord) -> bool:
    """Return whether a closed loop has no inaccurate or failed step, and no fallback."""
    is_failed = loop.failed_steps > 0 or loop.fallbacks > 0
    return loop.error_move_max <= Requirements().error_move and not is_failed


def _is_loop_of_solver(run: RunRecord) -> bool:
    """Return whether a run is a closed loop of a solver of scaled QPs without a slowdown."""
    is_solver = not run.is_baseline_law and run.units == "scaled"
    return run.mode == "closed_loop" and is_solver and not run.slowdown > 0.0


def _is_sent_to_another_position(run: RunRecord) -> bool:
    """Return whether a run's scenario starts beyond the limits of the station at its setpoint."""
    scenario = (run.scenario_documents or {}).get("scenario", {})
    start, reference = (scenario.get(key) or {} for key in ("start", "reference"))
    pose = ("north_m", "east_m", "heading_deg")
    north_m, east_m, turn_deg = (reference.get(key, 0.0) - start.get(key, 0.0) for key in pose)
    return math.hypot(north_m, east_m) > RADIUS_M or abs(turn_deg) > HEADING_DEG


def find_ship_results(records: Records) -> list[ShipResult]:
    """Return the ship's result in every scenario of a folder, and in every sea of its studies.

    Of several runs in a scenario the one with the longest reference loop counts.
    """
    with_ship = [
        run
        for run in records.all_runs
        if (run.scenario or run.exact_steps > 0.0) and not run.is_of_own_plant
    ]
    by_ship = group_by_key(with_ship, _make_ship_key)
    tuned = {key[:-1] for key in by_ship if key[-1] is not None}
    longest = {
        max(own, key=lambda run: _count_or_minus_one(run.exact_steps)): own
        for key, own in by_ship.items()
        # QPs without horizons, as of a consequence analysis, have the ship of the scenario's loop.
        if key[-1] is not None or key[:-1] not in tuned
    }
    tunings = group_by_key(longest, lambda run: (run.study, run.scenario))
    return [
        ShipResult(
            _name_scenario_of_ship(run, several=len(tunings[run.study, run.scenario]) > 1),
            run,
            tuple(filter(_is_loop_of_solver, own)),
        )
        for run, own in longest.items()
    ]


def _make_ship_key(run: RunRecord) -> tuple[object, ...]:
    """Return a key that is equal for runs of the same ship, weather and controller."""
    sea = run.study, _count_or_minus_one(run.study_point), _count_or_minus_one(run.replicate)
    return *sea, run.scenario, run.horizons


def _count_or_minus_one(count: float) -> float:
    """Return a count; −1 where it is missing (NaN), so that it can be compared and sorted."""
    return -1.0 if math.isnan(count) else count


def _name_scenario_of_ship(run: RunRecord, *, several: bool) -> str:
    """Return the name of a run's scenario, with the horizons where there are `several`."""
    if run.horizons is None or run.study or not several:
        return run.scenario
    return "{} {}/{}".format(run.scenario, *run.horizons)


SHIP_COLUMNS = (
    *("exact_steps", "station_radius_m", "exact_left_s", "exact_offset_max_m"),
    *("exact_offset_max_s", "exact_offset_end_m", "exact_heading_max_deg"),
    *("exact_heading_end_deg", "exact_loss_offset_max_m", "exact_loss_heading_max_deg"),
    "exact_loss_swing_m",
    *("exact_offset_rise_m", "exact_transfer_offset_max_m", "exact_transfer_s"),
    "exact_active_share",
)


def tabulate_ship_results(ships: Sequence[ShipResult]) -> pd.DataFrame:
    """Return a table of ship results: scenario, study's point and sea, state, `SHIP_COLUMNS`."""
    rows = [
        {
            "scenario": ship.name,
            "study": ship.run.study,
            "study_point": ship.run.study_point,
            "replicate": ship.run.replicate,
            "ship": ship.state,
            **{name: getattr(ship.run, name) for name in SHIP_COLUMNS},
        }
        for ship in ships
    ]
    return pd.DataFrame(rows)

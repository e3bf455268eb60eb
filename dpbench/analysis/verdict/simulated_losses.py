"""Losses of thrusters that closed loops simulate, and what the ship does after each of them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.ship.thrusters import ThrusterSet


def list_losses(run: RunRecord) -> list[tuple[float, list[str]]]:
    """Return the time [s] and the names of each loss of thrusters in a run, in order of time."""
    faults = (run.scenario_documents or {}).get("scenario", {}).get("faults") or ()
    losses = [(fault["at_s"], [*map(str, fault["lost"])]) for fault in faults if fault.get("lost")]
    return sorted(losses, key=lambda loss: loss[0])


def list_lost_so_far(run: RunRecord, thrusters: ThrusterSet) -> list[tuple[float, set[int]]]:
    """Return the time [s] of each loss in a run, and the indices of all thrusters lost by then."""
    so_far = list[tuple[float, set[int]]]()
    lost = set[int]()
    for at_s, names in list_losses(run):
        lost |= thrusters.find_indices_of_thrusters_or_groups(names, run.scenario, "faults.lost")
        so_far.append((at_s, set(lost)))
    return so_far


@dataclass(frozen=True)
class SimulatedLoss:
    """Loss of one whole thruster group, and of nothing else, in a closed loop.

    at_s : its time; next_s : time of the next loss, ∞ without one.
    """

    at_s: float
    next_s: float
    ship: ShipResult

    @property
    def duration_s(self) -> float:
        """Time for which the closed loop goes on without another loss [s]."""
        run = self.ship.run
        return float(min(self.next_s, run.exact_steps * run.sample_s) - self.at_s)

    @property
    def has_ship_left(self) -> bool:
        """True if the ship leaves its station after this loss and before the next one."""
        ship = self.ship
        return ship.has_left_station and self.at_s <= ship.run.exact_left_s < self.next_s


def list_simulated_losses(
    group: str, thrusters: ThrusterSet, ships: Sequence[ShipResult]
) -> Iterator[SimulatedLoss]:
    """Yield each simulated loss of a whole thruster group alone; a double loss is none."""
    members = set(thrusters.indices_by_failure_group[group])
    for ship in ships:
        so_far = list_lost_so_far(ship.run, thrusters)
        next_s = [at_s for at_s, _ in so_far[1:]] + [math.inf]
        for (at_s, lost), until_s in zip(so_far, next_s, strict=False):
            if lost == members and at_s < min(until_s, ship.run.exact_steps * ship.run.sample_s):
                yield SimulatedLoss(at_s, until_s, ship)

"""Check that memory stays flat: 200 000 steps in one process a solver, 5000 cells in one campaign.

    python benchmarks/soak_memory.py [--share 0.01] [--solver NAME]... [--skip-campaign]

    steps       loops of `paper` with one workspace after the other in one process, as a batch of
                cells runs them; the resident memory of the process after each loop
    cells       random problems of one step in one campaign; the resident memory of the process
                that supervises it

The first tenth is warm-up: what a library keeps once is no leak. Beyond it the memory may grow by
5 %, from the median of the second tenth to that of the last. The exit code is 1 where one grows
by more, and each line names the growth of one solver, and what that is for a step.
"""

import argparse
import gc
import multiprocessing
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from dpbench import load_scenario, open_workspace, run_campaign
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import Layout, RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.solvers.contract import Policy
from dpbench.solvers.table import TABLE, find_solver_availability

STEPS, CELLS = 200_000, 5_000
LOOPS, LONGEST = 40, 1000
"""Loops a solver has at least where steps are few, and steps that a loop has at most."""
ALLOWED = 0.05
"""Growth of the resident memory behind the warm-up."""
SUITE = """
title = "Memory of a campaign"
solvers = ["quadprog"]
baseline_law = false
rounds = 1
warmup_steps = 0

[[random]]
families = ["no_rows"]
sizes = [[3, 0]]
seeds = {seeds}
steps = 1
"""


@dataclass(frozen=True)
class Growth:
    """Resident memory behind the warm-up and at the end [B], and so many steps or cells between."""

    name: str
    before: float
    after: float
    count: int

    @property
    def is_flat(self) -> bool:
        """True where memory grew by no more than is allowed."""
        return self.after <= (1.0 + ALLOWED) * self.before

    def __str__(self) -> str:
        share, each = self.after / self.before - 1.0, (self.after - self.before) / self.count
        verdict = "flat" if self.is_flat else "GROWS"
        memory = f"{self.before / 1e6:.1f} to {self.after / 1e6:.1f} MB"
        return f"{self.name:34} {verdict:6} {100 * share:+6.2f} %  {memory}  {each:+8.1f} B each"


def growth(name: str, resident: Sequence[int], count: int) -> Growth:
    """The growth over `count` steps or cells, of the resident memory at even distances [B]."""
    tenth = max(1, len(resident) // 10)
    early, late = resident[tenth : 2 * tenth], resident[-tenth:]
    between = max(1, round(0.85 * count))
    return Growth(name, float(np.median(early)), float(np.median(late)), between)


def resident_bytes() -> int:
    """Resident memory of this process."""
    return int(psutil.Process().memory_info().rss)


def loops(solver: str, policy: Policy, steps: int) -> list[int]:
    """Resident memory after each of many loops of a solver, of so many steps together [B]."""
    each = max(1, min(steps // LOOPS, LONGEST))
    scenario = load_scenario("paper")
    scenario = scenario.truncate(min(each, scenario.steps))
    route = "native" if "native" in TABLE[solver].routes else "qpsolvers"
    cell = Cell("closed_loop", scenario.files, solver, route, policy, "default", scenario.steps)
    log: list[RawLog] = []

    def same_log(layout: Layout) -> RawLog:
        # One log for all loops, so that its pages are no growth.
        log[:] = log or [RawLog.in_memory(layout)]
        return log[0]

    # As a worker does.
    gc.collect()
    gc.freeze()
    gc.disable()
    resident = []
    for _ in range(max(20, steps // scenario.steps)):
        workspace = open_workspace(solver, route=route, policy=policy)
        record_closed_loop(
            build_closed_loop_setup(cell, scenario, workspace, same_log, NO_LIMIT_NS)
        )
        del workspace
        gc.collect()
        resident.append(resident_bytes())
    return resident


def of_solver(asked: tuple[str, Policy, int]) -> Growth:
    """The growth of a process in which one solver steers."""
    solver, policy, steps = asked
    return growth(f"{solver} {policy}", loops(solver, policy, steps), steps)


class Watching(Silent):
    """Takes down the resident memory of this process as cells end."""

    def __init__(self) -> None:
        self.resident: list[int] = []

    def advance(self, work: int, what: str) -> None:
        self.resident.append(resident_bytes())


def of_campaign(cells: int) -> Growth:
    """The growth of the process that supervises a campaign of so many cells."""
    watching = Watching()
    with tempfile.TemporaryDirectory() as folder:
        suite = Path(folder) / "soak.toml"
        suite.write_text(SUITE.format(seeds=[*range(cells)]), encoding="utf-8")
        run_campaign(suite, Path(folder) / "out", progress=watching)
    return growth("campaign", watching.resident, cells)


def main() -> int:
    """Print a line for each solver and the campaign; 1 where memory grows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, metavar="N", help="of steps and cells")
    parser.add_argument("--solver", action="append", metavar="NAME", help="only this one")
    parser.add_argument("--skip-campaign", action="store_true", help="run the loops alone")
    asked = parser.parse_args()
    steps, cells = round(asked.share * STEPS), max(20, round(asked.share * CELLS))
    solvers = asked.solver or [name for name in TABLE if find_solver_availability(name).ok]
    found = []
    # A process of its own for each: what a library keeps is its own.
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for solver in solvers:
            row = TABLE[solver]
            route = "native" if "native" in row.routes else "qpsolvers"
            found.append(
                pool.apply(of_solver, ((solver, row.policies_by_route[route][-1], steps),))
            )
            print(found[-1], flush=True)
    if not asked.skip_campaign:
        found.append(of_campaign(cells))
        print(found[-1], flush=True)
    return 0 if all(one.is_flat for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())

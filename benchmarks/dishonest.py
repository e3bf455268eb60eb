"""Check that solvers with a stated fault of time never meet the demand, and honest ones do.

Each fault of `dishonest_solver.py` is run beside its honest twin, DAQP, and other solvers, while
two processes keep both cores busy. A fault must end as late, open or wrong; the twin must meet.

    python benchmarks/dishonest.py [--passes N] [--neighbours N] [FAULT ...]
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from dishonest_solver import FAULTS

SUITE = """
title = "Dishonest solvers beside honest ones"
solvers = ["dishonest", "daqp", "quadprog", "piqp", "osqp"]
baseline_law = false
calibration = true
cell_limit_s = 60.0
rounds = 5
warmup_steps = 50
{loops}
[[replay]]
scenario = "paper"
routes = ["native"]
policies = ["warm", "reuse"]
"""
LOOP = """
[[closed_loop]]
scenarios = ["paper"]
routes = ["native"]
policies = ["{policy}"]
solvers = {solvers}
"""


def _busy() -> None:
    while True:
        pass


@contextmanager
def neighbours(count: int) -> Iterator[None]:
    """Keep so many processes busy meanwhile."""
    processes = [multiprocessing.Process(target=_busy, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()


def states(fault: str, folder: Path) -> dict[str, tuple[str, str]]:
    """Run one fault and return the state of each solver with the reason for it."""
    # Imported here, so that the variables for threads are set before NumPy loads.
    from dpbench import load_results, run_campaign
    from dpbench.analysis.verdict.fastest import best_of_each
    from dpbench.report.report import Report
    from dpbench.report.verdict_text import clauses

    shutil.rmtree(Path(tempfile.gettempdir()) / f"dpbench-dishonest-{os.getuid()}", True)
    loops = LOOP.format(policy="warm", solvers='["dishonest", "daqp"]')
    loops += LOOP.format(policy="reuse", solvers='["quadprog", "piqp", "osqp"]')
    suite = folder / "dishonest.toml"
    suite.write_text(SUITE.format(loops=loops), encoding="utf-8")
    out = run_campaign(
        suite,
        folder / "out",
        fresh=True,
        solver_module=Path(__file__).with_name("dishonest_solver.py"),
    )
    verdicts = Report.of(load_results(out)).facts.verdicts
    best = {v.configuration.solver: v for v in best_of_each(verdicts)}
    return {name: (v.state, clauses(v.causes or v.missing)) for name, v in best.items()}


def _one(fault: str) -> int:
    """Print the states of one fault, in a process of its own; 1 where one is not as it must be."""
    with tempfile.TemporaryDirectory() as folder:
        found = states(fault, Path(folder))
    (own, why), (twin, why_not) = found["dishonest"], found["daqp"]
    wanted = ("late", "open", "wrong") if fault != "honest" else ("meets",)
    good = own in wanted and twin == "meets"
    print(f"{'ok ' if good else 'BAD'} {fault:18} {own:10} {why[:110]}", flush=True)
    if twin != "meets":
        print(f"    honest twin: {twin} {why_not}", flush=True)
    return int(not good)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run faults, each in its own process, as the environment variable names it."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="only these; all by default")
    parser.add_argument("--passes", type=int, default=1, metavar="N")
    parser.add_argument("--neighbours", type=int, default=2, metavar="N", help="busy processes")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.one:
        return _one(asked.faults[0])
    chosen = asked.faults or ["honest", *FAULTS]
    outcomes: Counter[bool] = Counter()
    with neighbours(asked.neighbours):
        for _ in range(asked.passes):
            for fault in chosen:
                variables = {"DPBENCH_FAULT": fault, "OMP_NUM_THREADS": "1"}
                variables |= {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
                command = [sys.executable, __file__, "--one", fault]
                code = os.spawnve(os.P_WAIT, sys.executable, command, os.environ | variables)
                outcomes[code == 0] += 1
    print(f"{outcomes[True]} as they must be, {outcomes[False]} not")
    return int(outcomes[False] > 0)


if __name__ == "__main__":
    sys.exit(main())

"""Check that solvers with a stated fault of time never pass, and honest ones do.

The faults of `dishonest_solver.py` are run some at a time beside their honest twin, DAQP, and other
solvers, while two processes keep both cores busy. A fault must end as late, inconclusive or fail;
the twin, and a copy of it that is loaded as the faults are, must meet.

    python benchmarks/dishonest.py [--passes N] [--neighbours N] [--together N] [FAULT ...]
"""

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
from random import Random

from dishonest_solver import FAULTS

THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
HONEST, TWIN = "honest", "daqp"
BESIDE = ("quadprog", "piqp", "osqp")
SUITE = """
title = "Dishonest solvers beside honest ones"
solvers = {solvers}
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


def states(faults: Sequence[str], folder: Path) -> dict[str, tuple[str, str]]:
    """Run faults in one campaign and return the state of each solver with the reason for it."""
    # Imported here, so that the variables for threads are set before NumPy loads.
    from dpbench import load_results, run_campaign
    from dpbench.analysis.verdict.verdict import list_best_verdict_of_each_solver
    from dpbench.report.report import Report
    from dpbench.report.verdict.findings_text import describe_findings
    from dpbench.solvers.table import load_plugin_solver_from_file

    shutil.rmtree(Path(tempfile.gettempdir()) / f"dpbench-dishonest-{os.getuid()}", True)
    for fault in faults:
        module = folder / f"{fault}.py"
        shutil.copyfile(Path(__file__).with_name("dishonest_solver.py"), module)
        load_plugin_solver_from_file(module)
    loops = LOOP.format(policy="warm", solvers=_list([*faults, TWIN]))
    loops += LOOP.format(policy="reuse", solvers=_list(BESIDE))
    suite = folder / "dishonest.toml"
    solvers = _list([*faults, TWIN, *BESIDE])
    suite.write_text(SUITE.format(solvers=solvers, loops=loops), encoding="utf-8")
    verdicts = Report.from_results(load_results(run_campaign(suite, folder / "out"))).data.verdicts
    best = {v.configuration.solver: v for v in list_best_verdict_of_each_solver(verdicts)}
    return {
        name: (v.state, describe_findings(v.causes or v.findings_that_bar_pass))
        for name, v in best.items()
    }


def _list(names: Sequence[str]) -> str:
    """Names as a list in TOML."""
    return str([*names]).replace("'", '"')


def _campaign(faults: Sequence[str]) -> int:
    """Print the states of faults, in a process of its own; how many are not as they must be."""
    with tempfile.TemporaryDirectory() as folder:
        found = states(faults, Path(folder))
    wrong = 0
    for solver in (*faults, TWIN):
        state, why = found[solver]
        wanted = ("pass",) if solver in (HONEST, TWIN) else ("late", "inconclusive", "fail")
        wrong += state not in wanted
        print(f"{'ok ' if state in wanted else 'BAD'} {solver:18} {state:10} {why[:110]}")
    return wrong


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all faults in campaigns of some of them, drawn anew for each pass."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("faults", nargs="*", metavar="FAULT", help="only these; all by default")
    parser.add_argument("--passes", type=int, default=1, metavar="N")
    parser.add_argument(
        "--first", type=int, default=1, metavar="N", help="number of the first pass"
    )
    parser.add_argument("--neighbours", type=int, default=2, metavar="N", help="busy processes")
    parser.add_argument("--together", type=int, default=6, metavar="N", help="faults a campaign")
    parser.add_argument("--campaign", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.campaign:
        return _campaign(asked.faults)
    chosen, outcomes = asked.faults or [HONEST, *FAULTS], Counter[str]()
    with neighbours(asked.neighbours):
        for i in range(asked.first, asked.first + asked.passes):
            drawn = Random(i).sample(chosen, len(chosen))
            for first in range(0, len(drawn), asked.together):
                some = drawn[first : first + asked.together]
                command = [sys.executable, __file__, "--campaign", *some]
                wrong = os.spawnve(os.P_WAIT, sys.executable, command, os.environ | THREADS)
                outcomes["wrong"] += wrong
                outcomes["all"] += len(some) + 1
            print(
                f"pass {i}: {outcomes['wrong']} of {outcomes['all']} not as they must be",
                flush=True,
            )
    return int(outcomes["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())

"""Compile all kernels, so that no command waits for one: `python -m dpbench.cli.compiling`."""

import subprocess
import sys
import time

from dpbench.bench.workers.child import LOOP, has_compiled_kernels
from dpbench.notebook.runs import run_closed_loop
from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.open import open_workspace


def compile_all_kernels() -> None:
    """Compile to the disk cache all Numba functions not yet in it; print the time taken."""
    if has_compiled_kernels():
        return
    print("compiling the kernels, once after installation: one or two minutes", flush=True)
    started = time.monotonic()
    subprocess.run([sys.executable, "-c", f"import {LOOP}"], check=False)
    # Observers, thrusters and the like compile when a scenario's first step asks for them.
    for name in list_shipped_problem_names("scenarios"):
        run_closed_loop(load_scenario(name).truncate(2), open_workspace("paper_active_set"))
    print(f"compiled in {time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    compile_all_kernels()

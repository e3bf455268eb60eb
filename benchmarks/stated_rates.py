"""Renew the step times by which `dpbench run --dry-run` forecasts a first run.

    python benchmarks/stated_rates.py results/reference FOLDER ...

Writes `dpbench/bench/stated_rates.toml` from the runs of some result folders. They need QPs of each
size in `SIZES`, as the suites `standard` and `thrusters` have.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from dpbench.bench import estimate
from dpbench.solvers.calibration import CALIBRATION

SIZES = (30, 60, 340)
"""Variables and rows of the QPs: horizons 30/5 and 60/10, and commanded thrusters at 60/10."""
COLUMNS = ["solver", "route", "mode", "formulation", "n", "m", "rounds", "steps_done", "replay_s"]
OUT = Path(estimate.__file__).with_name("stated_rates.toml")


def read_step_times(folders: list[str]) -> pd.DataFrame:
    """Return the median time of a step with all around it [µs] by solver, route and size."""
    paths = [Path(folder) / "runs.parquet" for folder in folders]
    runs = pd.concat([pd.read_parquet(path, columns=COLUMNS) for path in paths])
    runs = runs[runs["replay_s"].notna() & runs["formulation"].isin(("condensed_box", "none"))]
    recorded = runs["steps_done"] * runs["rounds"].where(runs["mode"] == "replay", 1)
    runs = runs.assign(step_us=1e6 * runs["replay_s"] / recorded, size=runs["n"] + runs["m"])
    runs = runs[runs["size"].isin(SIZES) & (recorded > 0)]
    names = ["solver", "route", "size"]
    return runs.groupby(names, observed=True)["step_us"].median().unstack("size")


def fill_missing(times: pd.DataFrame) -> pd.DataFrame:
    """Fill the time at a size that a solver did not run by the usual growth from its smallest size.

    The harness's own configurations take as long at any size.
    """
    own = times.index.get_level_values("solver").isin(CALIBRATION)
    times.loc[own] = times.loc[own].ffill(axis="columns")
    growth = times.div(times[SIZES[0]], axis=0).median()
    return times.fillna(pd.DataFrame(np.outer(times[SIZES[0]], growth), times.index, times.columns))


def rates_toml(times: pd.DataFrame) -> str:
    """Return the table as TOML, a line for each solver and route."""
    head = [
        "# Times of a step with all around it [µs], for a machine where nothing was measured yet:",
        "# medians on two cores of a shared virtual machine, by `benchmarks/stated_rates.py`.",
        "",
        f"sizes = {list(SIZES)} # variables and rows of the QPs",
        "",
        "[times]",
    ]
    lines = [
        f'"{solver} {route}" = {[round(float(f"{us:.2g}")) for us in row]}'
        for (solver, route), row in zip(times.index, times.to_numpy(), strict=True)
    ]
    return "\n".join([*head, *lines]) + "\n"


if __name__ == "__main__":
    OUT.write_text(rates_toml(fill_missing(read_step_times(sys.argv[1:]))), encoding="utf-8")

"""Small suites of tests, and what another run of the same cells has, bit for bit."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from dpbench import load_results
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import ACCURACY_COLUMNS, CONTROL_COLUMNS, STEP_COLUMNS

OF_TIME = {"deadline_misses", "longest_miss_streak", "miss_recover_steps_max", "interrupted"}
RUN = ["run_id", "cell", "outcome", "machine_id", "concurrency", "steps_done"]
RUN += [*ACCURACY_COLUMNS, *CONTROL_COLUMNS]


def deterministic(results: Results) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The columns of runs and of steps that are no times, nor follow from them."""
    runs = results.runs[[name for name in RUN if name not in OF_TIME and name[-3:] != "_ns"]]
    steps = results.steps.sort_values(["run_id", "repeat", "k"], ignore_index=True)
    of_time = {name for name in STEP_COLUMNS if name.endswith("_ns")}
    of_time |= {"late", "disturbed", "counts"}
    return runs, steps[[name for name in STEP_COLUMNS if name not in of_time]]


def assert_same(found: Path, wanted: Path) -> None:
    """Two result folders have the same cells, each once, and the same in all that is no time."""
    results = load_results(found)
    assert results.runs["run_id"].is_unique
    tables = deterministic(results), deterministic(load_results(wanted))
    for one, other in zip(*tables, strict=True):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


def head(**fields: object) -> str:
    """The head of a small suite in TOML, of daqp alone unless `fields` have other solvers."""
    usual = {"solvers": ["daqp"], "baseline_law": False, "cell_limit_s": 60.0}
    values = {"title": "A suite for one test"} | usual | fields
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


def wait_until(is_true: Callable[[], object], failure: str) -> None:
    """Wait for some seconds until a condition holds."""
    deadline = time.monotonic() + 20.0
    while not is_true():
        assert time.monotonic() < deadline, failure
        time.sleep(0.01)

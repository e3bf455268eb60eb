"""Small suites of tests, and what another run of the same cells has, bit for bit."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench import load_results, run_campaign
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


def suite_toml(**fields: object) -> str:
    """A small suite, daqp alone unless `fields` have other solvers; a list of dicts is tables."""
    usual = {"solvers": ["daqp"], "baseline_law": False, "cell_limit_s": 60.0}
    lines, tables = [], list[str]()
    for key, value in ({"title": "A suite for one test"} | usual | fields).items():
        if isinstance(value, list) and isinstance(value[0], dict):
            for table in value:
                rows = (f"{name} = {_inline(of_row)}" for name, of_row in table.items())
                tables += ["", f"[[{key}]]", *rows]
        else:
            lines.append(f"{key} = {_inline(value)}")
    return "\n".join([*lines, *tables, ""])


def _inline(value: object) -> str:
    if not isinstance(value, dict):
        return json.dumps(value)
    return "{ " + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items()) + " }"


def suite_file(folder: Path, text: str) -> Path:
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return path


def run_suite(folder: Path, text: str, **given: Any) -> Path:
    """The results of a suite, which is written into a folder beside them."""
    return run_campaign(suite_file(folder, text), folder / "out", **given)


def wait_until(is_true: Callable[[], object], failure: str) -> None:
    deadline = time.monotonic() + 20.0
    while not is_true():
        assert time.monotonic() < deadline, failure
        time.sleep(0.01)

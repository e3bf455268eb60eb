"""The table of all runs on the page, by groups of columns, and the cells of its grid."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pandas as pd

from dpbench.analysis.records.run_record import build_run_records
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.report.page.data import PageData, convert_to_json_number

GROUPS: dict[str, str] = {
    "times": (
        "algo_p50_ns algo_p99_ns algo_max_ns raw_p50_ns raw_p99_ns raw_max_ns raw_samples "
        "rounds disturbed_rounds"
    ),
    "accuracy": (
        "error_move_max error_plan_max failed_steps claimed_not_true true_share "
        "iterations_p50 iterations_max"
    ),
    "control": (
        "r_rms_m r_max_m settle_s dev_position_max_m total_variation closed_loop_cost exact_cost"
    ),
    "deadline": (
        "slowdown deadline_misses longest_miss_streak latency_p50_ns latency_max_ns fallbacks "
        "recover_steps_max backup_acted backup_failures backup_max_ns"
    ),
    "memory": (
        "peak_rss_bytes python_peak_bytes_per_step heap_growth_bytes_per_step os_threads "
        "bit_identical_share voluntary_switches involuntary_switches"
    ),
    "run": "options solver_version build units formulation n m steps_done run_id",
}
"""Columns of the page, a group at a time."""
TIMES = {
    "algo_p50_ns": "p50",
    "algo_p99_ns": "p99",
    "algo_max_ns": "hardest step",
    "raw_p50_ns": "p50 of timings",
    "raw_p99_ns": "p99 of timings",
    "raw_max_ns": "largest timing",
}
"""Labels of the columns of times."""
MOST_TILES = 1000
"""Each tile is two nodes of the browser."""
MOST_ROWS = 3000
"""Runs on the page; the file has all."""


def make_table_of_runs(data: PageData, runs: pd.DataFrame) -> dict[str, Any]:
    """Return the table of runs as columns for the page's script, without empty columns."""
    runs = runs.iloc[:MOST_ROWS]
    by_id = {run.run_id: key for key, run in data.runs.items()}
    keys = [by_id.get(str(run_id)) for run_id in runs["run_id"]]
    always: dict[str, Iterable[Any]] = {
        "solver": runs["solver"],
        "call mode": runs["route"] + " " + runs["policy"],
        "settings": runs["settings"],
        "where": [
            replace(Experiment.from_run(run), slowdown=0.0).label for run in build_run_records(runs)
        ],
        "outcome": runs["outcome"],
        "verdict": [
            ""
            if key is None or data.experiments[key[1]].study
            else data.get_state_in_experiment(*key)
            for key in keys
        ],
    }
    columns: list[dict[str, Any]] = [
        {"name": n, "label": n, "meaning": "", "group": "", "text": True} for n in always
    ]
    values: list[list[Any]] = [list(map(str, column)) for column in always.values()]
    for group, names in GROUPS.items():
        for name in names.split():
            kind, meaning = RUN_COLUMNS[name]
            text = kind == "str"
            cells = (
                [str(x) for x in runs[name]]
                if text
                else [convert_to_json_number(x) for x in runs[name]]
            )
            if all(x in ("", None) for x in cells):
                continue
            label: dict[str, Any] = {"label": name}
            if name.endswith("_ns"):
                short = TIMES.get(name, name.removesuffix("_ns"))
                label = {"label": f"{short} [µs]", "scale": 1e-3}
            described = {"name": name, "meaning": meaning, "group": group, "text": text}
            columns.append(described | label)
            values.append(cells)
    return {
        "rows": len(runs),
        "columns": columns,
        "values": values,
        "c": [None if key is None else key[0] for key in keys],
        "p": [None if key is None else key[1] for key in keys],
    }


def select_tiles(tiles: pd.DataFrame) -> pd.DataFrame:
    """Select from the table of verdicts the scenarios with the fewest passes, as many as fit."""
    if len(tiles) <= MOST_TILES:
        return tiles
    experiments = tiles.groupby("experiment", sort=False)["verdict"]
    room = max(1, MOST_TILES * len(experiments) // len(tiles))
    unmet = experiments.agg(lambda states: int((states != "pass").sum()))
    kept = unmet.sort_values(ascending=False, kind="stable").index[:room]
    return tiles[tiles["experiment"].isin(kept)]

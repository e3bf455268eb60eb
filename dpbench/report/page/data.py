"""Data of the page: its runs by configuration and experiment, packed steps, table of all runs."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import INACCURACY_COLUMNS, Records, find_inaccurate_steps
from dpbench.analysis.records.run_record import RunRecord, build_run_records
from dpbench.analysis.records.run_steps import MEASURES, find_hardest_steps
from dpbench.analysis.records.thinned_runs import FORCES, TRACK, ThinnedRun, Track, thin_track
from dpbench.analysis.suites.embedded import EmbeddedResults
from dpbench.analysis.suites.study import Study, find_studies
from dpbench.analysis.suites.study_tables import (
    compute_error_excess_cm,
    convert_difference_to_cm,
    find_id_of_worst_run,
)
from dpbench.analysis.verdict.run_matrix import (
    Experiment,
    RunMatrix,
    get_configuration_in_common_form,
)
from dpbench.analysis.verdict.ship_results import ShipResult, find_ship_results
from dpbench.analysis.verdict.verdict import Verdicts
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.report.formats import as_float, plural
from dpbench.report.page.pack import MOST_HARD, Block, Room, pack_steps, pack_track
from dpbench.report.verdict.findings_text import describe_findings
from dpbench.solvers.calibration import CALIBRATION

MOST_RUNS = 20_000
"""Runs of studies on the page with their errors; the files have all."""
MOST_LOOPS = 400
"""Runs of studies on the page with their steps."""
MOST_WINDOW_STEPS = 5
"""Steps of a configuration's windows in the page's list of extreme steps."""


def select_shown_runs(runs: Iterable[RunRecord]) -> list[RunRecord]:
    """Return the study runs that the report page shows, the first sea of all points first."""
    solving = [run for run in runs if not run.is_baseline_law]
    return sorted(solving, key=lambda run: run.replicate)[:MOST_RUNS]


def make_study_document(
    study: Study, runs: Mapping[str, RunRecord], number_of: Mapping[str, int]
) -> dict[str, Any]:
    """Return a study's points, configurations and runs as JSON data for the page's script.

    runs : those that are shown, by run_id.
    number_of : number on the page of a configuration, by name.
    """
    rows = study.runs[study.runs["run_id"].isin(list(runs))]
    names = [c.name for c in study.results_by_cost if c.name in number_of]
    rows = rows[rows["configuration"].isin(names)]
    place = {name: i for i, name in enumerate(names)}
    return {
        "name": study.name,
        "radius_m": study.radius_m,
        "bound_of_none_percent": study.bound_of_none_percent,
        "reference": place.get(study.reference_name, 0),
        "keys": [str(key) for key in study.points],
        "points": [int(point) for point in study.points.index],
        "values": [
            [None if isinstance(x, float) and not math.isfinite(x) else x for x in column.tolist()]
            for _, column in study.points.items()
        ],
        "names": names,
        "c": [number_of[name] for name in names],
        "means": [_compute_mean_excess_error(study, name) for name in names],
        "runs": {
            "of": [place[name] for name in rows["configuration"]],
            "point": rows["point"].tolist(),
            "sea": rows["replicate"].tolist(),
            "within": [None if math.isnan(share) else int(share) for share in rows["within"]],
            "tail_m": _round_values(rows["r_tail_max_m"].where(rows["finished"])),
            "error_excess_cm": _round_values(compute_error_excess_cm(study, rows)),
            "id": rows["run_id"].tolist(),
        },
    }


def _compute_mean_excess_error(study: Study, name: str) -> dict[str, Any]:
    """Return a configuration's mean excess error [cm], its interval, share of seas within."""
    (found,) = (c for c in study.results_by_cost if c.name == name)
    within = None if math.isnan(found.within) else found.within
    known: dict[str, Any] = {"within": within, "pairs": 0}
    if found.error_excess_m is None or found.error_excess_m.pairs == 0:
        return known
    return known | convert_difference_to_cm(found.error_excess_m)


def _round_values(values: Iterable[float]) -> list[float | None]:
    """Return numbers rounded to four significant digits; None for NaN and infinity."""
    return [float(f"{x:.4g}") if math.isfinite(x) else None for x in values]


@dataclass(eq=False)
class PageData(RunMatrix):
    """Runs and verdicts for the report page, with steps packed into compressed arrays."""

    block: Block = field(default_factory=Block)
    counts: EmbeddedResults = field(default_factory=lambda: EmbeddedResults(()))

    @classmethod
    def from_verdicts(
        cls, records: Records, verdicts: Verdicts, counted: pd.DataFrame | None = None
    ) -> Self:
        """Return the report page's data, from a folder's runs and the verdicts on solvers.

        counted : steps of `embedded.parquet`, if there are any.
        """
        data = cls.from_records(records, verdicts, select_shown_runs(records.study), MOST_LOOPS)
        data.counts = EmbeddedResults.from_counted_steps(records, counted)
        return data

    @cached_property
    def ships(self) -> list[ShipResult]:
        """Results of the controller itself: the ship of each scenario and sea."""
        return find_ship_results(self.records)

    @cached_property
    def studies(self) -> list[Study]:
        """All studies of the result folder."""
        return find_studies(self.records)

    @cached_property
    def study_documents(self) -> list[dict[str, Any]]:
        """Points, configurations and runs of each study, as JSON data for the page's script."""
        runs = {run.run_id: run for run in select_shown_runs(self.records.study)}
        numbers = {
            run.solver_label: self.find_index(get_configuration_in_common_form(run))
            for run in runs.values()
        }
        return [make_study_document(study, runs, numbers) for study in self.studies]

    @property
    def opening(self) -> tuple[int, int] | None:
        """Indices of configuration and study run the page shows first; None if not of studies."""
        if self.judged_experiment_indices or not self.studies:
            return None
        study, shown = self.studies[0], select_shown_runs(self.records.study)[:MOST_LOOPS]
        kept = {run.run_id: run for run in shown if run.study == study.name}
        worst = find_id_of_worst_run(study, list(kept))
        if worst is None:
            return None
        run = kept[worst]
        return self.find_index(get_configuration_in_common_form(run)), self.experiments.index(
            Experiment.from_run(run)
        )

    @cached_property
    def thinned_runs(self) -> dict[str, ThinnedRun]:
        """Steps of every run, thinned to what the report page has room for, by run id."""
        runs = {run.run_id: run for run in self.runs.values()}
        room = Room.from_run_lengths([run.steps_done for run in runs.values() if run.has_steps])
        kept: dict[str, ThinnedRun] = {}
        columns = (*TRACK, *FORCES, *INACCURACY_COLUMNS)
        read = self.records.yield_merged_and_raw_steps(list(runs.values()), columns)
        for run_id, steps, rows in read:
            run = runs[run_id]
            scenario, track = (
                self.build_scenario_of_run(run) if run.mode == "closed_loop" else None,
                None,
            )
            if scenario is not None:
                limits = np.maximum(scenario.vessel.tau_max, -scenario.vessel.tau_min)
                track = thin_track(rows, limits, room.points)
            inaccurate = find_inaccurate_steps(rows, self.requirements.error_move)
            kept[run_id] = ThinnedRun.from_run(steps, room.steps, track, inaccurate)
        return kept

    @cached_property
    def loop_indices(self) -> dict[str, int]:
        """Index of each scenario's closed loop in scaled units on this computer, by scenario."""
        return {
            experiment.name: p
            for p, experiment in enumerate(self.experiments)
            if (experiment.mode, experiment.units, experiment.study)
            == ("closed_loop", "scaled", "")
            and not experiment.slowdown
        }

    @cached_property
    def longest_window_steps(self) -> dict[Configuration, list[tuple[int, int, float]]]:
        """Slowest steps of all windows by configuration: loop's experiment index, k, time [ns]."""
        loops = self.loop_indices
        windows = {
            run.run_id: run for _, run in self.windows if run.has_steps and run.scenario in loops
        }
        found: dict[Configuration, list[tuple[int, int, float]]] = {}
        for run_id, steps, _ in self.records.yield_merged_and_raw_steps([*windows.values()]):
            run = windows[run_id]
            own = found.setdefault(get_configuration_in_common_form(run), [])
            own += [
                (loops[run.scenario], run.first_step + int(steps.k[i]), float(steps.time_ns[i]))
                for i in find_hardest_steps(steps, "time", MOST_WINDOW_STEPS)
            ]
        return {
            c: sorted(own, key=lambda step: -step[2])[:MOST_WINDOW_STEPS]
            for c, own in found.items()
        }

    @property
    def thinned_count(self) -> int:
        """Number of runs of which the page shows only a part of the steps."""
        return sum(not run.is_whole for run in self.thinned_runs.values())

    def cells(self) -> Iterator[dict[str, Any]]:
        """Yield each run's results, packed steps and hardest steps, for the page's script.

        Steps are numbered as in the scenario.
        """
        references: dict[int, Track] = {}
        hard = max(1, min(5, MOST_HARD // max(1, len(MEASURES) * len(self.runs))))
        # The run nearest to the exact loop comes first: the others' tracks refer to it.
        off_m = {k: np.nan_to_num(r.dev_position_max_m, nan=np.inf) for k, r in self.runs.items()}
        for c, p in sorted(self.runs, key=lambda key: (key[1], off_m[key])):
            run = self.runs[c, p]
            entry, kept = self._describe_run(c, p, run), self.thinned_runs.get(run.run_id)
            if kept is not None:
                first, (entry["inaccurate"], k) = run.first_step, kept.inaccurate
                entry["first_inaccurate"] = first + k if k >= 0 else None
                hardest = [
                    [
                        [first + k, convert_to_json_number(x), status, int(claimed), int(true), n]
                        for k, x, status, claimed, true, n in kept.hard[measure][:hard]
                    ]
                    for measure in MEASURES
                ]
                entry |= pack_steps(self.block, kept) | {"hard": hardest}
                entry["first"] += first
                if kept.track is not None:
                    entry |= pack_track(self.block, kept.track, references.get(p))
                    entry["reference"] = p not in references
                    references.setdefault(p, kept.track)
            yield entry

    def _describe_run(self, c: int, p: int, run: RunRecord) -> dict[str, Any]:
        """Return the facts of a run that the page's script needs: verdict, outcome, errors."""
        known = self.records.failed_steps_by_run.get(run.run_id)
        verdict, state = self.states[c, p], self.get_state_in_experiment(c, p)
        # Of a fail, other facts have the reason. The page shows no verdict on a study run.
        reasons = {"fail": (), "late": verdict.causes}.get(state, (*verdict.doubts, *verdict.near))
        return {
            "c": c,
            "p": p,
            "id": run.run_id,
            "verdict": state,
            "reason": "" if self.experiments[p].study else describe_findings(reasons),
            "outcome": run.outcome,
            "why": run.outcome_detail[:200],
            "infeasible": convert_to_json_number(run.infeasible_steps),
            "all_true": run.true_share == 1.0,
            "steps": run.steps_done,
            "answers": int(run.steps_done * max(1.0, run.rounds)),
            "planned": run.steps_planned,
            "error": convert_to_json_number(run.error_move_max),
            "failed": convert_to_json_number(run.failed_steps),
            "first_failed": None if known is None else run.first_step + known.first,
            "untrue": convert_to_json_number(run.claimed_not_true),
            "off_m": convert_to_json_number(run.dev_position_max_m),
            "setpoint_m": convert_to_json_number(run.r_max_m),
        }


def convert_to_json_number(value: object) -> float | str | None:
    """Return a number for JSON: None where it is missing, "inf" where infinite."""
    x = as_float(value)
    if math.isnan(x):
        return None
    return x if math.isfinite(x) else "inf"


def convert_rows_to_columns(rows: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return lists of column values by name, of a list of rows (dictionaries)."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name) for row in rows] for name in names}


GROUPS: dict[str, str] = {
    "times": (
        "algo_p50_ns algo_p99_ns window_p99_ns scaled_p99_ns algo_max_ns raw_p50_ns raw_p99_ns "
        "raw_max_ns raw_samples rounds disturbed_rounds"
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
        "energy_J_per_step bit_identical_share voluntary_switches involuntary_switches"
    ),
    "run": "options solver_version build units formulation n m steps_done run_id",
}
"""Columns of the page, a group at a time."""
LABELS = {
    "where": "scenario or replay",
    "algo_p50_ns": "p50",
    "algo_p99_ns": "p99",
    "window_p99_ns": "p99 of window",
    "scaled_p99_ns": "scaled p99",
    "algo_max_ns": "largest step time",
    "raw_p50_ns": "p50 of single timings",
    "raw_p99_ns": "p99 of single timings",
    "raw_max_ns": "largest single timing",
    "raw_samples": "timings",
    "error_move_max": "error of first move",
    "error_plan_max": "error of plan",
    "claimed_not_true": "false claims",
    "true_share": "verified share",
    "iterations_p50": "p50 of iterations",
    "iterations_max": "most iterations",
    "r_rms_m": "radial error, RMS [m]",
    "r_max_m": "radial error, largest [m]",
    "settle_s": "settling time (1 m, 1°) [s]",
    "dev_position_max_m": "deviation, largest [m]",
    "closed_loop_cost": "closed-loop cost",
    "exact_cost": "cost of reference loop",
    "longest_miss_streak": "longest run of misses",
    "latency_p50_ns": "p50 of latency",
    "latency_max_ns": "largest latency",
    "recover_steps_max": "steps to recover",
    "backup_acted": "steps by backup",
    "backup_max_ns": "longest backup",
    "peak_rss_bytes": "peak memory [bytes]",
    "python_peak_bytes_per_step": "Python peak per step [bytes]",
    "heap_growth_bytes_per_step": "heap growth per step [bytes]",
    "os_threads": "threads",
    "energy_J_per_step": "energy per step [J]",
    "bit_identical_share": "bit-identical share",
    "n": "variables",
    "m": "rows",
    "run_id": "run_id",
}
"""Labels of columns on the page; others are their names with spaces."""
COLUMNS = {
    **RUN_COLUMNS,
    "scaled_p99_ns": (
        "float64",
        "p99, scaled up if the p99 of iterations is larger in the closed loop; the largest of a "
        "configuration is its limiting p99",
    ),
}
"""Type and meaning of the columns of runs, with that which only the page has."""
MOST_TILES = 1000
"""Each tile is two nodes of the browser."""
MOST_ROWS = 3000
"""Runs on the page; the file has all."""


def make_table_of_runs(data: PageData, runs: pd.DataFrame) -> dict[str, Any]:
    """Return the table of runs as columns for the page's script, without empty columns.

    A window leads to its closed loop, if the page has that.
    """
    runs = runs.iloc[:MOST_ROWS]
    slowdown = runs["slowdown"].replace(0.0, np.nan)  # 0 stands for this machine
    runs = runs.assign(scaled_p99_ns=_compute_scaled_p99_ns(data, runs), slowdown=slowdown)
    by_id = {run.run_id: key for key, run in data.runs.items()}
    keys = [by_id.get(str(run_id)) for run_id in runs["run_id"]]
    of_windows = {
        run.run_id: (c, data.loop_indices.get(run.scenario))
        for configuration, run in data.windows
        if (c := data.find_index(configuration)) >= 0
    }
    window_keys = [of_windows.get(str(run_id)) for run_id in runs["run_id"]]
    shown = [key or window for key, window in zip(keys, window_keys, strict=True)]
    always: dict[str, Iterable[Any]] = {
        "solver": runs["solver"],
        "call mode": runs["route"] + " " + runs["policy"],
        "settings": runs["settings"],
        "where": list(map(_name_scenario_or_replay, build_run_records(runs))),
        "outcome": runs["outcome"],
        "verdict": [
            ""
            if key is None or data.experiments[key[1]].study
            else data.get_state_in_experiment(*key)
            for key in keys
        ],
    }
    columns: list[dict[str, Any]] = [
        {"name": n, "label": LABELS.get(n, n), "meaning": "", "group": "", "text": True}
        for n in always
    ]
    values: list[list[Any]] = [list(map(str, column)) for column in always.values()]
    for group, names in GROUPS.items():
        for name in names.split():
            kind, meaning = COLUMNS[name]
            text = kind == "str"
            cells = (
                [str(x) for x in runs[name]]
                if text
                else [convert_to_json_number(x) for x in runs[name]]
            )
            if all(x in ("", None) for x in cells):
                continue
            short = LABELS.get(name, name.replace("_", " "))
            label: dict[str, Any] = {"label": short}
            if name.endswith("_ns"):
                label = {"label": f"{short} [µs]", "scale": 1e-3}
            described = {"name": name, "meaning": meaning, "group": group, "text": text}
            columns.append(described | label)
            values.append(cells)
    return {
        "rows": len(runs),
        "calibration_runs": int(runs["solver"].isin(list(CALIBRATION)).sum()),
        "columns": columns,
        "values": values,
        "c": [None if key is None else key[0] for key in shown],
        "p": [None if key is None or key not in data.runs else key[1] for key in shown],
        "windows": [i for i, key in enumerate(window_keys) if key is not None],
    }


def _name_scenario_or_replay(run: RunRecord) -> str:
    """Return the name of what a run solved: a scenario, replay, study realisation or window."""
    if run.steps_searched_for_hardest:
        steps = plural(run.steps_planned, "step")
        if not math.isnan(run.first_sample):
            steps = f"steps {run.first_step} to {run.first_step + run.steps_planned - 1}"
        return f"{run.sequence.rsplit(' hardest ')[0]}, window of {steps}"
    return replace(Experiment.from_run(run), slowdown=0.0).label


def _compute_scaled_p99_ns(data: PageData, runs: pd.DataFrame) -> "pd.Series[float]":
    """Return the p99 of each replay and window (R,) [ns], scaled up to its loop; or NaN."""
    factors = {run.run_id: run.untimed_iterations for run in data.records.runs}
    scale = runs["run_id"].astype(str).map(factors).astype(np.float64).fillna(1.0)
    return runs["algo_p99_ns"].fillna(runs["window_p99_ns"]) * scale


def select_tiles(tiles: pd.DataFrame) -> pd.DataFrame:
    """Return the verdict table's rows of the scenarios with the fewest passes, as many as fit."""
    if len(tiles) <= MOST_TILES:
        return tiles
    experiments = tiles.groupby("experiment", sort=False)["verdict"]
    room = max(1, MOST_TILES * len(experiments) // len(tiles))
    unmet = experiments.agg(lambda states: int((states != "pass").sum()))
    kept = unmet.sort_values(ascending=False, kind="stable").index[:room]
    return tiles[tiles["experiment"].isin(kept)]

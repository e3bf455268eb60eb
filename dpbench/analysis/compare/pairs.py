"""Pairs of cells of two result folders with the same configuration, and how their answers differ.

Accuracy and control are compared as far as no clock enters them. A deterministic solver repeats
them bit for bit, so nothing is estimated: a figure differs by more than the margin, beyond what the
rounds of one run differ, or not. Where a time limit stopped a run, accuracy is compared on the
steps before that.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, map_first_by_key
from dpbench.bench.judge.rules import mask_decided_steps, mask_failed_steps
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS
from dpbench.errors import ResultsError
from dpbench.qp.solution import Status
from dpbench.scenario.problem_files import omit_prose
from dpbench.solvers.own_settings import decode_options_from_json, format_each_option_as_toml

KEY = ("mode", "scenario", "sequence", *CONFIGURATION_COLUMNS, "steps_planned")
"""Columns that two cells share when they ask the same question of the same configuration."""
Key = tuple[Any, ...]
LASTING = ("cpu_model", "cores", "memory_GiB", "kernel", "python", "versions")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two runs of one solver configuration on one problem, from result folders A and B."""

    a: RunRecord
    b: RunRecord

    @property
    def configuration_label(self) -> str:
        """Name of the paired runs' solver configuration, with both versions where they differ."""
        old, new = (f"{run.solver_version} {run.build}".strip() for run in (self.a, self.b))
        versions = "" if old == new else f" {old} → {new}"
        label = self.a.configuration.make_label_with_name(f"{self.a.solver}{versions}")
        return f"{label} with {change}" if (change := self.changed_options_text) else label

    @property
    def measurement_key(self) -> tuple[object, ...]:
        """Key that is equal for two measured runs paired under several names of settings."""
        return self.a.measurement_key, self.b.measurement_key, self.a.steps_planned

    @property
    def changed_options_text(self) -> str:
        """Options of custom settings that differ, such as `rho 1.6 → 0.01`; "" for none."""
        old, new = (
            format_each_option_as_toml(decode_options_from_json(run.options))
            for run in (self.a, self.b)
        )
        return ", ".join(
            f"{name} {old.get(name, 'not set')} → {new.get(name, 'not set')}"
            for name in sorted({*old, *new})
            if old.get(name) != new.get(name)
        )


@dataclass(frozen=True, eq=False)
class Pairs:
    """Paired runs of two result folders, and descriptions of the runs left unpaired.

    refused, repeated : the pairs that both folders refused to run, and those that repeat another
        pair under another name of its settings. They are not in `pairs`.
    """

    pairs: list[Pair]
    refused: list[Pair]
    repeated: list[Pair]
    only_a: list[str]
    only_b: list[str]
    changed: list[str]
    lost: list[str]


def list_machine_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """Return the properties, as processor, in which two computers differ; empty for the same."""
    if a["id"] == b["id"]:
        return []
    differ = [name for name in LASTING if a.get(name) != b.get(name)]
    return differ or ["what neither describes"]


def pair_runs_of_folders(a: Records, b: Records, names: tuple[str, str]) -> Pairs:
    """Return the runs of two result folders, paired by configuration and problem.

    Custom settings whose options changed are paired by their name. A cell whose problem changed
    under its name has no partner.

    Raises
    ------
    ResultsError : when no cell of one folder has a partner in the other.
    """
    cells_a, cells_b = _map_runs_by_identity(a), _map_runs_by_identity(b)
    pairs, refused, changed, lost = [], [], [], []
    partners = {key: key for key in cells_a if key in cells_b} | _pair_keys_of_changed_options(
        cells_a, cells_b
    )
    for key in (key for key in cells_a if key in partners):
        pair = Pair(cells_a[key], cells_b[partners[key]])
        outcomes = pair.a.outcome, pair.b.outcome
        if make_problem_key(pair.a) != make_problem_key(pair.b):
            changed.append(_describe_run(pair.a))
        elif "lost" in outcomes:
            lost.append(_describe_run(pair.a))
        elif outcomes == ("refused", "refused"):
            refused.append(pair)
        else:
            pairs.append(pair)
    if not pairs and not lost:
        missing = f"no cell in common with {names[0]}"
        allowed = "results of the same suite"
        if renamed := _find_renamed_settings(cells_a, cells_b):
            missing += f", as the names of settings differ, such as {' and '.join(renamed)}"
            allowed += ", with the same names of settings"
        raise ResultsError(names[1], "", missing, allowed)
    only_a = [_describe_run(run) for key, run in cells_a.items() if key not in partners]
    found = set(partners.values())
    first = map_first_by_key(pairs, lambda pair: pair.measurement_key)
    repeated = [pair for pair in pairs if first[pair.measurement_key] is not pair]
    only_b = [_describe_run(run) for key, run in cells_b.items() if key not in found]
    return Pairs(list(first.values()), refused, repeated, only_a, only_b, changed, lost)


def _find_renamed_settings(
    cells_a: Mapping[Key, RunRecord], cells_b: Mapping[Key, RunRecord]
) -> tuple[str, str] | None:
    """Return the settings of the first cells that differ in these alone; None without such."""
    unnamed = {"settings": "", "options": ""}
    first: dict[tuple[object, ...], RunRecord] = {}
    for run in cells_a.values():
        columns = pick_identifying_columns(run) | unnamed
        first.setdefault((*columns.values(), _identify_study_point(run)), run)
    for run in cells_b.values():
        columns = pick_identifying_columns(run) | unnamed
        partner = first.get((*columns.values(), _identify_study_point(run)))
        if partner is not None and make_problem_key(partner) == make_problem_key(run):
            return partner.settings, run.settings
    return None


def _pair_keys_of_changed_options(
    cells_a: Mapping[Key, RunRecord], cells_b: Mapping[Key, RunRecord]
) -> dict[Key, Key]:
    """Return unpaired run keys of A, mapped to B's that differ in one settings' options alone."""
    named_a, named_b = (
        _group_unpaired_keys_by_name(cells_a, cells_b),
        _group_unpaired_keys_by_name(cells_b, cells_a),
    )
    both = ((named_a[name], named_b[name]) for name in named_a if name in named_b)
    return {a[0]: b[0] for a, b in both if len(a) == len(b) == 1}


def _group_unpaired_keys_by_name(
    cells: Mapping[Key, RunRecord], others: Mapping[Key, RunRecord]
) -> dict[Key, list[Key]]:
    """Return the run keys that only one folder has, by what names them without their options."""
    groups: dict[Key, list[Key]] = {}
    for key, run in cells.items():
        if run.options and key not in others:
            columns = pick_identifying_columns(run) | {"options": ""}
            name = (*columns.values(), *_identify_study_point(run))
            groups.setdefault(name, []).append(key)
    return groups


def pick_identifying_columns(run: RunRecord) -> dict[str, Any]:
    """Return a run's identifying column values by name: mode, problem, configuration, steps."""
    return {column: getattr(run, column) for column in KEY}


def _map_runs_by_identity(records: Records) -> dict[Key, RunRecord]:
    """Return runs by their identifying column values, simulated slow computers left out."""
    # A loop on a slow computer takes another course each time: its answers' delays are measured.
    lasting = (run for run in records.all_runs if not run.slowdown > 0.0)
    return {
        (*pick_identifying_columns(run).values(), *_identify_study_point(run)): run
        for run in lasting
    }


def _identify_study_point(run: RunRecord) -> Key:
    """Return a study's name, point and realisation of a run; the same for all runs of none."""
    point = {key: str(value) for key, value in sorted(run.x.items())}
    return (run.study, tuple(point.items()), run.replicate) if run.study else ()


def _describe_run(run: RunRecord) -> str:
    """Return a text that names a run by configuration, options, mode, steps and problem."""
    mode, options = run.mode.replace("_", " "), run.configuration.options_text
    label = run.configuration.label + (f" with {options}" if options else "")
    point = ", ".join(f"{key} = {value}" for key, value in run.x.items())
    study = f", {point}, realisation {run.replicate:.0f}" if run.study else ""
    return f"{label}, {mode} of {run.steps_planned} steps of {run.problem}{study}"


def make_problem_key(run: RunRecord) -> tuple[object, ...]:
    """Return what defines a run's problem, for comparison: scenario, origin of QPs, fallbacks."""
    files = {
        name: omit_prose(document) if isinstance(document, Mapping) else document
        for name, document in run.files.items()
    }
    return files, run.source, run.first, run.fallback, run.backup


Change = Literal["worse", "better", "same", "not comparable"]
Range = tuple[float, float]

ERROR_FLOOR = 1e-9
"""Errors below it are rounding: an active-set solver's 1e-15 may become 1e-13."""
CONTROL_FLOOR = 1e-12
"""Control figures below it are zero [m, deg, 1]."""
ORDER = ("finished", "timed_out", "invalid", "refused", "hung", "crashed")
"""Outcomes, best first."""
BY_CLOCK = ({"finished", "timed_out"}, {"timed_out", "hung"})
"""Outcomes between which the speed of the machine decides."""


@dataclass(frozen=True)
class Measure:
    """Accuracy or control quantity of a run, as RMS position, and the least change that counts."""

    column: str
    head: str
    less_is_better: bool
    relative: bool
    floor: float


ACCURACY = (
    Measure("error_move_max", "largest error of the first move", True, True, ERROR_FLOOR),
    Measure("error_plan_max", "largest error of the plan", True, True, ERROR_FLOOR),
    Measure("true_share", "share of true answers", False, False, 0.0),
    Measure("failed_steps", "failed steps", True, False, 0.0),
)
CONTROL = (
    Measure("r_rms_m", "position, RMS [m]", True, True, CONTROL_FLOOR),
    Measure("closed_loop_cost", "closed-loop cost", True, True, CONTROL_FLOOR),
    Measure("total_variation", "total variation of the force", True, True, CONTROL_FLOOR),
)
OUTCOME = Measure("outcome", "outcome", True, False, 0.0)
DONE = Measure("steps_done", "steps done", False, False, 0.0)


@dataclass(frozen=True, eq=False)
class FigureChange:
    """Accuracy or control quantity of two paired runs A and B: ranges in both and its change."""

    pair: Pair
    measure: Measure
    a: Range
    b: Range
    change: Change

    @property
    def table_row(self) -> dict[str, Any]:
        """Table row: run identity, name of the compared quantity, its ranges in A and B, change."""
        ranges = dict(zip(("a_low", "a_high", "b_low", "b_high"), self.a + self.b, strict=True))
        figure = {"figure": self.measure.column}
        return pick_identifying_columns(self.pair.a) | figure | ranges | {"change": self.change}


def compare_accuracy_and_control(
    a: Records, b: Records, pairs: Sequence[Pair], margin: float
) -> list[FigureChange]:
    """Return for each quantity of accuracy and control of paired runs A, B: worse, better, same."""
    answers = []
    for pair in pairs:
        for measure, in_a, in_b, repeats in _yield_compared_ranges(a, b, pair):
            change = (
                _classify_change_of_range(measure, in_a, in_b, margin)
                if repeats
                else "not comparable"
            )
            answers.append(FigureChange(pair, measure, in_a, in_b, change))
    return answers


def _yield_compared_ranges(
    a: Records, b: Records, pair: Pair
) -> Iterator[tuple[Measure, Range, Range, bool]]:
    """Yield each accuracy or control quantity of a pair of runs: both ranges, if comparable."""
    outcomes = pair.a.outcome, pair.b.outcome
    if pair.a.outcome != pair.b.outcome:
        by_clock = set(outcomes) in BY_CLOCK
        in_a, in_b = (_make_range_of_number(ORDER.index(outcome)) for outcome in outcomes)
        yield OUTCOME, in_a, in_b, not by_clock
        if not by_clock:
            return
    if not (pair.a.has_steps or pair.b.has_steps):
        return
    steps = [view.read_step_table(run, _STEPS) for view, run in ((a, pair.a), (b, pair.b))]
    complete = "timed_out" not in outcomes and "hung" not in outcomes
    if complete:
        yield (
            DONE,
            _make_range_of_number(pair.a.steps_done),
            _make_range_of_number(pair.b.steps_done),
            True,
        )
    repeated = min(
        pair.a.steps_done, pair.b.steps_done, *map(_find_first_step_cut_by_time_limit, steps)
    )
    unlimited = complete and all(np.isinf(_find_first_step_cut_by_time_limit(one)) for one in steps)
    accurate = unlimited or (repeated > 0 and not any(one.empty for one in steps))
    ranges_a, ranges_b = (
        _compute_accuracy_ranges(one, run, repeated)
        for one, run in zip(steps, (pair.a, pair.b), strict=True)
    )
    # The steps before `repeated` alone are counted: not known of a folder without steps.
    counted_alike = steps[0].empty == steps[1].empty
    hangs = any(map(_fails_on_every_step, steps))
    for measure in ACCURACY:
        is_of_failures = measure.column == "failed_steps"
        if counted_alike or not is_of_failures:
            repeats = accurate or (is_of_failures and hangs)
            yield measure, ranges_a[measure.column], ranges_b[measure.column], repeats
    for measure in CONTROL if pair.a.mode == "closed_loop" else ():
        in_a, in_b = (
            _make_range_of_number(getattr(run, measure.column)) for run in (pair.a, pair.b)
        )
        yield measure, in_a, in_b, unlimited


def _make_range_of_number(value: float) -> Range:
    """Return a single number as the range (low, high) with both ends equal to it."""
    return float(value), float(value)


def _classify_change_of_range(measure: Measure, a: Range, b: Range, margin: float) -> Change:
    """Return whether run B is worse, better or the same in a quantity, from its ranges in A, B."""
    missing_a, missing_b = math.isnan(a[0]), math.isnan(b[0])
    if missing_a or missing_b:
        return "same" if missing_a and missing_b else "worse" if missing_b else "better"
    factor = 1.0 + margin if measure.relative else 1.0
    if b[0] > max(factor * a[1], measure.floor):
        return "worse" if measure.less_is_better else "better"
    if a[0] > max(factor * b[1], measure.floor):
        return "better" if measure.less_is_better else "worse"
    return "same"


_STEPS = (
    *("repeat", "k", "counts", "status", "error_move", "error_plan", "true"),
    *("certificate", "fallback", "unconverged"),
)


def _find_first_step_cut_by_time_limit(steps: pd.DataFrame) -> float:
    """Return a run's first step whose solve the solver's time limit cut short; inf for none."""
    stopped = steps["k"][steps["status"] == Status.TIME_LIMIT.name]
    return float(stopped.min()) if len(stopped) else np.inf


def _fails_on_every_step(steps: pd.DataFrame) -> bool:
    """Return whether a run fails on every step, which the speed of a machine does not explain."""
    return not steps.empty and bool(mask_failed_steps(steps).all())


def _compute_accuracy_ranges(
    steps: pd.DataFrame, run: RunRecord, common: float
) -> dict[str, Range]:
    """Return each accuracy number's range over a run's repetitions, on steps before `common`."""
    compared = steps[steps["k"] < common]
    counting = compared[compared["counts"]]
    if counting.empty:
        return {m.column: _make_range_of_number(getattr(run, m.column)) for m in ACCURACY}
    true = counting["true"].where(mask_decided_steps(counting))
    rounds = counting.assign(true=true.astype(float)).groupby("repeat")
    failed = _make_range_of_number(compared["k"][mask_failed_steps(compared)].nunique())
    by_round = {
        "error_move_max": rounds["error_move"].max(),
        "error_plan_max": rounds["error_plan"].max(),
        "true_share": rounds["true"].mean(),
    }
    ranges = {name: (float(own.min()), float(own.max())) for name, own in by_round.items()}
    return {**ranges, "failed_steps": failed}

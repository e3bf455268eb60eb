"""Campaigns that measure settings of a solver: their QPs and suites, and scores from results.

QPs are those of recorded sequences, and of loops of scenarios.
"""

import hashlib
import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import SEPARATE, RunRecord, group_by_key
from dpbench.analysis.verdict.lateness import estimate_uncertainty
from dpbench.analysis.verdict.requirements import (
    LATE,
    Finding,
    Requirements,
    is_right_on_every_step,
)
from dpbench.analysis.verdict.time_findings import judge_replay_times
from dpbench.analysis.verdict.verdict import find_wrong_answers
from dpbench.bench.campaign import run_campaign
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import SuiteFile
from dpbench.bench.progress import Progress
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.sequences.source import read_sequence
from dpbench.bench.workers.jobs import count_steps
from dpbench.errors import SituationError, UnknownNameError
from dpbench.files.regular_files import write_text_atomically
from dpbench.qp.program import CONSTANT, QPSequence
from dpbench.scenario.problem_files import (
    is_shipped_sequence_name,
    make_unknown_qps_name_error,
    omit_prose,
    resolve_sequence_path,
)
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.contract import DEFAULT, LEVELS, Options, Policy, Route
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.solvers.settings import find_options_of_preset
from dpbench.solvers.table import PluginFiles
from dpbench.tuning.search import Score

_HORIZONS = ("prediction_horizon", "control_horizon")
FAILED = 12.0
"""Excess of a run without an answer, in decades of the error."""
CELL_LIMIT_S = 20.0
ROUNDS, WARMUP_STEPS = 5, 20
Settings = Sequence[Options] | Mapping[str, Options]
"""Options to measure, by name where they have one in the results."""


@dataclass(frozen=True)
class TunedProblem:
    """A source of QPs: its name in the results, its table of a suite, and what it consists of.

    loop : the scenario and ship that its QPs belong to, whatever the horizons, as JSON; "" if
        unknown. steps : the QPs of a recorded sequence. every : steps of the loop from one of its
        QPs to the next.
    """

    name: str
    table: dict[str, Any]
    loop: str = ""
    steps: frozenset[bytes] = field(default=frozenset(), repr=False)
    every: int = 1


def load_tuned_problem(name: str, steps: int = 0) -> TunedProblem:
    """Return the QPs of a sequence by name or file, or along the loop of a scenario.

    steps : of a scenario, only the first so many; 0 for all.

    Raises
    ------
    InputError : for a bad file. UnknownNameError : there is neither sequence nor scenario.
    """
    if is_shipped_sequence_name(name) or name.endswith(".npz") or Path(name).is_dir():
        path = resolve_sequence_path(name)
        recorded = read_sequence(path)
        origin = name if is_shipped_sequence_name(name) else str(path.resolve())
        sequence = recorded.sequence
        every = sequence.meta.get("every", 1)
        table: dict[str, Any] = {"kind": "recorded", "sequence": origin}
        return TunedProblem(
            sequence.name,
            table,
            _make_loop_key(sequence.documents),
            _hash_steps(sequence),
            every if isinstance(every, int) else 1,
        )
    try:
        scenario = load_scenario(name)
    except UnknownNameError as error:
        if "@" in name:  # The error may be about the vessel
            raise
        raise make_unknown_qps_name_error(name) from error
    origin = str(Path(name).resolve()) if name.endswith(".toml") else name
    table = {
        "kind": "replay",
        "scenario": origin,
        "steps": min(steps or scenario.steps, scenario.steps),
    }
    return TunedProblem(scenario.name, table, _make_loop_key(dict(scenario.files)))


def refuse_training_qps_in_test(
    training: Sequence[TunedProblem], test: Sequence[TunedProblem]
) -> None:
    """Raise InputError where QPs of the training are among those of the test.

    Sequences overlap that have a QP in common, or are of one closed loop, also at other horizons.
    """
    for mine in training:
        for other in test:
            same_loop = bool(mine.loop) and mine.loop == other.loop
            if mine.name == other.name or same_loop or mine.steps & other.steps:
                why = "QPs of the same closed loop" if same_loop else "the same QPs"
                raise SituationError(
                    "--test",
                    f"{other.name} has {why} as {mine.name} in the training set; name "
                    "sequences of other scenarios",
                )


def _make_loop_key(documents: dict[str, Any]) -> str:
    """Return a text equal for loops of one scenario and ship at any horizons; "" without them."""
    scenario, vessel = documents.get("scenario"), documents.get("vessel")
    if not isinstance(scenario, dict) or not isinstance(vessel, dict):
        return ""
    controller = scenario.get("controller", {})
    own = {key: value for key, value in controller.items() if key not in _HORIZONS}
    return json.dumps([omit_prose(scenario) | {"controller": own}, vessel], sort_keys=True)


def _hash_steps(sequence: QPSequence) -> frozenset[bytes]:
    """Return the SHA-256 of each QP: its matrices, and its vectors."""
    digests = set()
    for k in range(len(sequence)):
        qp = sequence.problem(k)
        digest = hashlib.sha256()
        for name in (*CONSTANT, "q", "l", "u"):
            digest.update(getattr(qp, name).tobytes())
        digests.add(digest.digest())
    return frozenset(digests)


@dataclass(frozen=True)
class TunedSolver:
    """The solver whose settings are measured, how it is called, and what is required of it."""

    name: str
    route: Route
    policy: Policy
    requirements: Requirements
    solver_module: PluginFiles = None


@dataclass(frozen=True)
class MeasuredRuns:
    """Runs of settings on sequences, and why some of them miss the requirements.

    faults : findings by run id, those on accuracy before those on time.
    """

    runs: Sequence[RunRecord]
    faults: Mapping[str, Sequence[Finding]] = field(default_factory=dict)

    def find_late(self, run: RunRecord) -> Finding | None:
        """Return the finding on a time of a run that is above its limit; None without one."""
        return next((f for f in self.faults.get(run.run_id, ()) if f.kind in LATE), None)


def load_measured_runs(folder: Path, requirements: Requirements) -> MeasuredRuns:
    """Return the runs of a result folder with their faults, by the rules of verdicts.

    A run is late if a percentile of its step times is above the limit, also without the waits for
    the processor core, by more than the uncertainty of the times.
    """
    records = Records(load_results(folder))
    uncertainty = estimate_uncertainty(records)
    faults: dict[str, Sequence[Finding]] = {}
    for run in records.all_runs:
        times, _ = judge_replay_times(records, [run], requirements, uncertainty)
        found = find_wrong_answers(records, [run], requirements)
        found += [finding for finding in times if finding.kind in LATE]
        if found:
            faults[run.run_id] = found
    return MeasuredRuns(records.all_runs, faults)


def find_trial_presets(solver: str) -> dict[str, Options]:
    """Return the options of the presets that a search tries first, by name; not of `default`."""
    presets = {name: find_options_of_preset(name, solver) for name in LEVELS}
    default = presets.pop(DEFAULT)
    return {name: options for name, options in presets.items() if options != default}


def split_off_presets(solver: str, settings: Sequence[Options]) -> tuple[list[Options], list[str]]:
    """Return the options that are of no preset, and the presets to measure beside them."""
    names = _name_in_results(solver, settings)
    own = [one for one, name in zip(settings, names, strict=True) if name not in LEVELS]
    return own, [DEFAULT, *(name for name in names if name in LEVELS)]


def _name_in_results(solver: str, settings: Sequence[Options]) -> list[str]:
    """Return the name of each settings in the results: that of a preset, or the options as text."""
    presets = {format_options_as_toml(o): name for name, o in find_trial_presets(solver).items()}
    texts = map(format_options_as_toml, settings)
    return [presets.get(text, text) for text in texts]


def plan_settings(
    solver: TunedSolver,
    problems: Sequence[TunedProblem],
    settings: Settings,
    presets: Sequence[str] = (DEFAULT,),
) -> list[PlannedCell]:
    """Return the planned runs that time settings and presets of a solver on some sequences."""
    document = tomllib.loads(format_suite_as_toml(solver, problems, settings, presets))
    return plan_suite(SuiteFile.model_validate(document))


def count_steps_of_settings(solver: TunedSolver, problems: Sequence[TunedProblem]) -> int:
    """Return how many steps a solver takes with default settings on some sequences."""
    return sum(count_steps(planned.cell) for planned in plan_settings(solver, problems, ()))


def measure_settings(
    solver: TunedSolver,
    problems: Sequence[TunedProblem],
    settings: Settings,
    folder: Path,
    progress: Progress,
    presets: Sequence[str] = (DEFAULT,),
    *,
    purpose: str = "",
    wait_s: float | None = None,
) -> MeasuredRuns:
    """Time settings of a solver and some of its presets side by side; return the runs.

    purpose : of the sequences, added to the title of the suite.
    The suite is written beside `folder`, which is the result folder. Finished runs are kept, unless
    an interruption left the times of one sequence to two commands: all are timed again then.
    """
    suite = folder.with_suffix(".toml")
    folder.parent.mkdir(parents=True, exist_ok=True)
    text = format_suite_as_toml(solver, problems, settings, presets, purpose)
    write_text_atomically(suite, text)
    measured = MeasuredRuns(())
    for fresh in (False, True):
        run_campaign(
            suite,
            folder,
            may_leave_out=True,
            progress=progress,
            solver_module=solver.solver_module,
            wait_s=wait_s,
            fresh=fresh,
        )
        measured = load_measured_runs(folder, solver.requirements)
        if not _has_separate_times(measured.runs):
            break
    return measured


def _has_separate_times(runs: Sequence[RunRecord]) -> bool:
    """Return whether runs on one sequence were timed in separate commands."""
    groups = group_by_key(runs, lambda run: run.sequence).values()
    return any(run.explain_separate_timing(one[0]) == SEPARATE for one in groups for run in one)


def format_suite_as_toml(
    solver: TunedSolver,
    problems: Sequence[TunedProblem],
    settings: Settings,
    presets: Sequence[str],
    purpose: str = "",
) -> str:
    """Return a suite as TOML: the solver with presets and other settings on some sequences."""
    named = settings if isinstance(settings, Mapping) else {}
    unnamed = [] if isinstance(settings, Mapping) else settings
    choices = [solver.name, *(f"{solver.name}[{format_options_as_toml(own)}]" for own in unnamed)]
    lines = [
        f"title = {json.dumps(f'Settings of {solver.name}{purpose}')}",
        f"solvers = {json.dumps(choices, ensure_ascii=False)}",
        "baseline_law = false",
        f"rounds = {ROUNDS}",
        f"warmup_steps = {WARMUP_STEPS}",
        f"cell_limit_s = {CELL_LIMIT_S}",
    ]
    for problem in problems:
        kind, *values = problem.table.items()
        calls = {
            "routes": [solver.route],
            "policies": [solver.policy],
            "settings": [*presets, *named],
        }
        lines += ["", f"[[{kind[1]}]]"]
        pairs = [*values, *calls.items()]
        lines += [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in pairs]
    for name, own in named.items():
        lines += ["", f"[settings.{name}]", f"{solver.name} = {{ {format_options_as_toml(own)} }}"]
    return "\n".join(lines) + "\n"


def name_step_times_ns(run: RunRecord) -> dict[str, float]:
    """Return the step times of a run that are known by name, the one to rank it by first.

    A percentile has ten steps beyond it; only a run of fewer than 20 steps is left to its largest.
    """
    times = {"p99": run.algo_p99_ns, "p95": run.algo_p95_ns, "p50": run.algo_p50_ns}
    return {name: ns for name, ns in times.items() if not math.isnan(ns)} | {
        "largest": run.algo_max_ns
    }


def _compute_time_ratio(run: RunRecord, default: RunRecord) -> float:
    """Return a run's step time over that with the default settings, both of the same name."""
    ours, theirs = name_step_times_ns(run), name_step_times_ns(default)
    name = next(name for name in ours if name in theirs)
    return ours[name] / theirs[name]


def find_step_of_largest_error(folder: Path, run: RunRecord) -> int:
    """Return the index k of a run's step of largest error of the first move, in any round."""
    steps = load_results(folder).steps
    own = steps[steps["run_id"] == run.run_id]
    return int(own["k"].to_numpy()[np.nanargmax(own["error_move"].to_numpy())])


def group_runs_by_settings(
    runs: Iterable[RunRecord], problems: Sequence[TunedProblem]
) -> dict[str, list[RunRecord]]:
    """Return the runs on some sequences by the name of their settings."""
    names = {problem.name for problem in problems}
    found: dict[str, list[RunRecord]] = {}
    for run in runs:
        if run.sequence in names:
            found.setdefault(run.settings, []).append(run)
    return found


def score_runs(
    runs: Sequence[RunRecord],
    defaults: Sequence[RunRecord],
    requirements: Requirements,
    measured: MeasuredRuns | None = None,
) -> Score:
    """Return the score of runs with the same settings, beside those with default settings.

    measured : the source of the runs' faults; without it, no run is late.
    """
    wrong = [run for run in runs if not is_right_on_every_step(run, requirements)]
    missing = len(defaults) - len(runs)
    default = {run.sequence: run for run in defaults}
    logs = [math.log(_compute_time_ratio(run, default[run.sequence])) for run in runs if not wrong]
    return Score(
        len(wrong) + missing,
        sum(_compute_error_excess_decades(run, requirements) for run in wrong) + FAILED * missing,
        math.exp(sum(logs) / len(logs)) if logs and not missing else math.nan,
        tuple(late for run in runs if measured and (late := measured.find_late(run))),
    )


def score_settings(
    solver: TunedSolver,
    settings: Sequence[Options],
    measured: MeasuredRuns,
    problems: Sequence[TunedProblem],
) -> list[Score]:
    """Return the score of each of some settings, from their runs on some sequences."""
    runs = group_runs_by_settings(measured.runs, problems)
    return [
        score_runs(runs.get(name, ()), runs[DEFAULT], solver.requirements, measured)
        for name in _name_in_results(solver.name, settings)
    ]


def _compute_error_excess_decades(run: RunRecord, requirements: Requirements) -> float:
    """Return by how many decades the error of a run is above the requirement; `FAILED` at most."""
    error = run.error_move_max
    if not math.isfinite(error) or run.steps_done < run.steps_planned:
        return FAILED
    return min(FAILED, max(0.0, math.log10(max(error, 1e-300) / requirements.error_move)))

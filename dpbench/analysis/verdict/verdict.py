"""Evaluate every configuration of every solver by the suite's requirements; choose the one to use.

A configuration *passes* when it was run, whole, in every scenario and replay in which its solver's
reference was judged, every judged step has error_move within the requirements, no more steps fail
than they allow, the p99 of its algorithmic step time stays below their limit in every replayed
sequence, and its single timings are no later than the machine explains (`lateness.py`).

It *fails* by a wrong or failed step or a process that crashed, and is *late* by time alone: a late
step, or a call that did not return. No time proves it that other programs may have caused
(`find_own_times_ns`). It is *inconclusive* where it was not run, could not be measured, may be
late, or no step has a feasible point. It is *borderline* where nothing of that holds and a time is
within its uncertainty of a limit (`estimate_uncertainty`). QPs without a sample time, in a folder
of their own, need no closed loop.

The fastest of all may exist only as this benchmark's own Python code; it is named, not recommended.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dpbench.analysis.records.records import NO_FAILED_STEPS, Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.statistics import UNKNOWN, Interval
from dpbench.analysis.verdict import time_findings
from dpbench.analysis.verdict.requirements import (
    DOUBTS,
    LATE,
    NEAR,
    OWN_DOING,
    STATES,
    UNFINISHED,
    Doubt,
    Finding,
    Requirements,
    State,
    make_finding_on_worst_runs,
)
from dpbench.bench.judge.rules import maximum_of_known
from dpbench.bench.record.cell import Configuration, RecordedSource, sort_key_of_settings
from dpbench.errors import UnknownNameError
from dpbench.solvers.contract import POLICIES, SolverRecord
from dpbench.solvers.own_settings import decode_options_from_json
from dpbench.solvers.table import find_solver_record


@dataclass(frozen=True)
class Verdict:
    """Verdict on one solver configuration, from pass to fail: reasons, step times, errors.

    near : times within their uncertainty of a limit.
    gaps : where its solver's reference was judged and this configuration was not, or not whole.
    refusal : why it was not run at all.
    has_plant : False of QPs without a sample time, which have no closed loop to be judged in.
    loops, replays, windows : how many of its runs were judged; is_beside_study : whether its folder
        has a study, whose loops are judged apart.
    steps : the steps with a judged answer; error_move : their largest error of the first move.
    p99_ns : limiting p99 of the algorithmic step time: the largest p99 of all replays and windows,
        each by as much longer as the closed loop has more iterations (`untimed_iterations.py`);
        that of `p99_run`, with `p99_interval` [ns], unknown of a window or a longer p99, and
        `p99_wait_ns`, the wait for the core in the step at it.
    p50_ns : on the sequence `timed_on`, of those replayed whole one that all timed configurations
        have in common, else that of the worst p99, or of the worst p50 where none supports a p99;
        NaN where the configuration has timed all steps of none.
    rounds_ns, replay_p99_ns, raw_p99_ns : there, median of the fastest and of the slowest round,
        p99 of the algorithmic step time, and of the single timings.
    iterations : there, median and largest of a step; NaN if the solver does not count them.
    disturbed_spread : largest `compute_round_spread` of its replays; 1 if the machine was quiet.
    of_sequences : these times by sequence, of all that can be `timed_on`.
    longest_ns : longest step of all replays and windows, each scaled as for `p99_ns`; that of
        `longest_run`.
    raw_max_ns : largest single timing of all sequences.
    """

    configuration: Configuration
    state: State
    causes: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()
    near: tuple[Finding, ...] = ()
    gaps: tuple[Finding, ...] = ()
    refusal: str = ""
    has_plant: bool = True
    loops: int = 0
    replays: int = 0
    windows: int = 0
    is_beside_study: bool = False
    steps: int = 0
    error_move: float = math.nan
    failed_steps: int = 0
    p50_ns: float = math.nan
    p99_ns: float = math.nan
    p99_interval: Interval = UNKNOWN
    p99_wait_ns: float = 0.0
    p99_run: RunRecord | None = None
    timed_on: str = ""
    rounds_ns: tuple[float, float] = (math.nan, math.nan)
    iterations: tuple[float, float] = (math.nan, math.nan)
    disturbed_spread: float = 1.0
    replay_p99_ns: float = math.nan
    raw_p99_ns: float = math.nan
    longest_ns: float = math.nan
    longest_run: RunRecord | None = None
    raw_max_ns: float = math.nan
    of_sequences: Mapping[str, Mapping[str, Any]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def sequence_of_limiting_p99(self) -> str:
        """Name of the QP sequence with the limiting p99; "" if nothing was timed."""
        return "" if self.p99_run is None else self.p99_run.sequence

    @property
    def is_rankable(self) -> bool:
        """True if the configuration was timed and no fault, doubt or missing run is known."""
        return not (self.causes or self.doubts or self.gaps) and self.timed_on != ""

    @property
    def is_finished(self) -> bool:
        """True if no run crashed, hung, was lost or stopped early."""
        return {f.kind for f in (*self.causes, *self.doubts)}.isdisjoint(UNFINISHED)

    @property
    def findings_that_bar_pass(self) -> tuple[Finding, ...]:
        """Findings that bar a pass but are no failure: doubts, times near a limit, missing runs."""
        kind: Doubt = "no loop but studied ones" if self.is_beside_study else "no closed loop"
        no_loop = () if self.loops or not self.has_plant else (Finding(kind),)
        no_replay = () if self.replays or self.windows else (Finding("no replay"),)
        return (*self.doubts, *self.near, *self.gaps, *no_loop, *no_replay)


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Verdicts on all configurations of a result folder, by solver."""

    requirements: Requirements
    of: Mapping[str, Sequence[Verdict]]

    @property
    def verdicts_on_references(self) -> list[Verdict]:
        """Verdict on each solver's reference configuration, in suite order."""
        return [verdicts[0] for verdicts in self.of.values()]

    @property
    def all_verdicts(self) -> list[Verdict]:
        """Verdicts on all configurations of all solvers, in one list."""
        return [verdict for verdicts in self.of.values() for verdict in verdicts]


def judge_solvers(
    records: Records, requirements: Requirements, among: Sequence[RunRecord] | None = None
) -> Verdicts:
    """Return verdicts on all solver configurations by accuracy and time limits, in suite order.

    among : the runs that are judged, of `records.runs`; by default all of them.
    """
    runs = records.runs if among is None else among
    judged = [run for run in runs if run.units == "scaled" and not run.is_baseline_law]
    verdicts: dict[str, list[Verdict]] = {}
    for solver, of_solver in group_by_key(judged, lambda run: run.solver).items():
        by_configuration = group_by_key(
            of_solver, lambda run: run.configuration.moved_to_common_formulation
        )
        longest = {it: _select_longest_runs(runs) for it, runs in by_configuration.items()}
        ordered = sorted(longest.items(), key=lambda item: _make_reference_sort_key(*item))
        asked = [run for run in ordered[0][1] if run.outcome != "refused"]
        verdicts[solver] = [
            judge_configuration(records, configuration, runs, asked, requirements)
            for configuration, runs in ordered
        ]
    return Verdicts(requirements, _time_on_common_sequence(verdicts))


def _time_on_common_sequence(
    verdicts: Mapping[str, Sequence[Verdict]],
) -> Mapping[str, Sequence[Verdict]]:
    """Return verdicts whose `timed_on` is one sequence, where all timed configurations share one.

    Of several, those with a p99 first, the one with the largest median step time, as geometric
    mean over configurations.
    """
    timed = [verdict for own in verdicts.values() for verdict in own if verdict.timed_on]
    if len({verdict.timed_on for verdict in timed}) < 2:
        return verdicts
    common = [
        name
        for name in timed[0].of_sequences
        if all(name in verdict.of_sequences for verdict in timed)
    ]
    if not common:
        return verdicts
    with_p99 = [
        name
        for name in common
        if all(math.isfinite(verdict.of_sequences[name]["replay_p99_ns"]) for verdict in timed)
    ]
    sequence = max(
        with_p99 or common,
        key=lambda name: sum(math.log(verdict.of_sequences[name]["p50_ns"]) for verdict in timed),
    )
    return {
        solver: [replace(v, **v.of_sequences[sequence]) if v.timed_on else v for v in own]
        for solver, own in verdicts.items()
    }


def _select_longest_runs(runs: Iterable[RunRecord]) -> list[RunRecord]:
    """Return the longest of the runs that share mode and problem."""
    alike = group_by_key(runs, lambda run: (run.mode, run.problem))
    return [max(own, key=lambda run: run.steps_planned) for own in alike.values()]


def _make_reference_sort_key(
    configuration: Configuration, runs: Sequence[RunRecord]
) -> tuple[Any, ...]:
    """Return a sort key that puts a solver's reference configuration first."""
    ran = [run for run in runs if run.outcome != "refused"]
    kinds = len({run.mode for run in ran})
    default = any(run.default_route for run in runs)
    return (
        sort_key_of_settings(configuration.settings) if ran else (99, ()),
        -kinds,
        not default,
        list(POLICIES).index(configuration.policy),
    )


def judge_configuration(
    records: Records,
    configuration: Configuration,
    runs: Sequence[RunRecord],
    asked: Sequence[RunRecord],
    requirements: Requirements,
) -> Verdict:
    """Return the verdict on a configuration's runs, by the limits on accuracy and time.

    runs : its longest run of each scenario and replay; asked : those of its solver's reference.
    """
    ran = [run for run in runs if run.outcome != "refused"]
    if not ran:
        return Verdict(configuration, "not run", refusal=explain_outcome(runs[0]))
    replays = [run for run in ran if run.mode == "replay"]
    late_timings, uncertainty = time_findings.find_late_timings_and_uncertainty(
        records, requirements
    )
    times, figures = time_findings.judge_replay_times(records, replays, requirements, uncertainty)
    times += time_findings.find_slow_loops(records, ran, requirements, uncertainty)
    times += time_findings.convert_late_timings_to_findings(ran, late_timings)
    times += time_findings.find_work_in_other_threads(ran)
    late, unsure, near = ([f for f in times if f.kind in kinds] for kinds in (LATE, DOUBTS, NEAR))
    own_doing = {kind: tuple(run for run in ran if run.outcome == kind) for kind in OWN_DOING}
    ended = [Finding(kind, of_kind) for kind, of_kind in own_doing.items() if of_kind]
    causes = [*find_wrong_answers(records, ran, requirements), *ended, *late]
    doubts = [*_find_unfinished(ran), *_find_lack_of_optima(ran), *unsure]
    gaps = _find_missing_runs(runs, asked)
    has_plant = requirements.judges_step_times or not all(
        isinstance(run.source, RecordedSource) for run in records.all_runs
    )
    is_whole = len({run.mode for run in ran}) == 2 or not has_plant
    return Verdict(
        configuration,
        _decide_overall_state(causes, [*doubts, *gaps], near, is_whole=is_whole),
        tuple(causes),
        tuple(doubts),
        tuple(near),
        tuple(gaps),
        has_plant=has_plant,
        loops=len(ran) - len(replays),
        replays=sum(not run.steps_searched_for_hardest for run in replays),
        windows=sum(run.steps_searched_for_hardest > 0 for run in replays),
        is_beside_study=bool(records.study),
        steps=sum(_count_judged_steps(run) for run in ran),
        error_move=maximum_of_known([run.error_move_max for run in ran]),
        failed_steps=sum(_count_or_zero(run.failed_steps) for run in ran),
        **figures,
    )


def _decide_overall_state(
    causes: Sequence[Finding],
    doubts: Sequence[Finding],
    near: Sequence[Finding],
    *,
    is_whole: bool,
) -> State:
    """Return the verdict, pass to fail, that faults, doubts and times near a limit lead to.

    is_whole : whether it was run in closed loop and replay, or in all there is.
    """
    if causes:
        return "late" if all(cause.kind in LATE for cause in causes) else "fail"
    if doubts or not is_whole:
        return "inconclusive"
    return "borderline" if near else "pass"


def explain_outcome(run: RunRecord) -> str:
    """Return why a run ended as it did, in words of the solver library or benchmark."""
    return run.outcome_message or "no reason was recorded"


def _count_or_zero(count: float) -> int:
    """Return a count as an integer; a missing one (NaN) is 0."""
    return int(count) if math.isfinite(count) else 0


def _count_judged_steps(run: RunRecord) -> int:
    """Return how many steps of a run have an answer whose accuracy was judged."""
    without = _count_or_zero(run.uncertified) + _count_or_zero(run.undecided_steps)
    return max(0, run.steps_done - _count_per_round(without, run))


def _count_per_round(count: int, run: RunRecord) -> int:
    """Return how many steps of a round a count over all rounds is; at least 1 if there are any."""
    rounds = max(1, _count_or_zero(run.rounds))
    return max(count // rounds, min(1, count))


def _find_missing_runs(runs: Sequence[RunRecord], asked: Sequence[RunRecord]) -> list[Finding]:
    """Return findings on runs of the reference configuration that another lacks or cut short."""
    known = {(run.mode, run.problem): run for run in runs}
    absent: list[RunRecord] = []
    gaps: list[Finding] = []
    for run in asked:
        own = known.get((run.mode, run.problem))
        if own is None:
            absent.append(run)
        elif own.outcome == "refused":
            gaps.append(Finding("refused", (own,)))
        elif own.steps_planned < run.steps_planned:
            gaps.append(Finding("short", (own,), steps=run.steps_planned))
    return [Finding("absent", tuple(absent)), *gaps] if absent else gaps


def find_wrong_answers(
    records: Records, runs: Sequence[RunRecord], requirements: Requirements
) -> list[Finding]:
    """Return findings on answers missing, inaccurate or failed by more than requirements allow."""
    off = [run for run in runs if run.error_move_max > requirements.error_move]
    silent = tuple(run for run in off if math.isinf(run.error_move_max))
    wrong = [run for run in off if math.isfinite(run.error_move_max)]
    no_answer = [Finding("no answer", silent)] if silent else []
    failing = [run for run in runs if run.failed_steps > requirements.failed_steps]
    failed = make_finding_on_worst_runs("failed", failing, lambda run: run.failed_steps)
    known = [records.failed_steps_by_run.get(f.runs[0].run_id, NO_FAILED_STEPS) for f in failed]
    inaccurate = make_finding_on_worst_runs("inaccurate", wrong, lambda run: run.error_move_max)
    located = [
        records.find_inaccurate_steps(f.runs[0], requirements.error_move) for f in inaccurate
    ]
    return [
        *no_answer,
        *(
            replace(f, steps=steps, first=first)
            for f, (steps, first) in zip(inaccurate, located, strict=True)
        ),
        *(replace(f, **own._asdict()) for f, own in zip(failed, known, strict=True)),
    ]


def _find_unfinished(runs: Sequence[RunRecord]) -> list[Finding]:
    """Return findings on runs that stopped early or have steps without a certified optimum."""
    doubts = []
    for run in runs:
        if run.outcome in OWN_DOING:
            continue
        if run.outcome == "timed_out" and run.mode == "replay" and run.has_all_steps:
            # Every step has an answer and a time; fewer rounds make that time no smaller.
            continue
        if run.outcome == "timed_out":
            done = run.steps_done
            doubts.append(Finding("stopped", (run,), value=done, steps=run.steps_planned))
        elif run.outcome == "lost":
            doubts.append(Finding("lost", (run,)))
        elif run.outcome != "finished":
            doubts.append(Finding("ended", (run,)))
        elif uncertified := _count_or_zero(run.uncertified):
            value = _count_per_round(uncertified, run)
            doubts.append(Finding("uncertified", (run,), value=value))
    return doubts


def _find_lack_of_optima(runs: Sequence[RunRecord]) -> list[Finding]:
    """Return a finding where no step of any run has a feasible point, so that no error is known."""
    return [Finding("no optimum", tuple(runs))] * all(run.has_no_optimum for run in runs)


ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""
MOST_SPREAD = 1.25
"""Ratio of a slow round to a fast one up to which their spread is noise of the fastest times."""
MOST_OWN = 12
"""Custom settings that are listed."""


def sort_fastest_first(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return verdicts on configurations sorted by limiting p99, else p50; untimed ones last."""
    return sorted(
        verdicts,
        key=lambda v: (
            *np.nan_to_num((v.p99_ns, v.p50_ns, v.longest_ns), nan=math.inf).tolist(),
            v.configuration.solver,
        ),
    )


def sort_best_first(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Return verdicts on configurations sorted from pass to fail, then by time.

    Those that fail are sorted by failed steps, then error, unfinished ones last.
    """
    return sorted(sort_fastest_first([*verdicts]), key=_make_quality_sort_key)


def _make_quality_sort_key(verdict: Verdict) -> tuple[int, bool, int, float]:
    """Return a sort key: the verdict, and for `fail` unfinished runs, failed steps and error."""
    state = STATES.index(verdict.state)
    if verdict.state != "fail":
        return state, False, 0, 0.0
    error = verdict.error_move
    known = error if math.isfinite(error) else math.inf
    return state, not verdict.is_finished, verdict.failed_steps, known


def rank_configurations(verdicts: Verdicts) -> list[Verdict]:
    """Return the configurations without faults timed on most QP sequences, fastest first.

    Of two names of one run the more usual settings.
    """
    ranks = [verdict for verdict in verdicts.all_verdicts if verdict.is_rankable]
    widest = max((verdict.replays for verdict in ranks), default=0)
    wide = [verdict for verdict in ranks if verdict.replays == widest]
    return sort_fastest_first(sorted(wide, key=_make_settings_sort_key))


def find_fastest_configuration(verdicts: Verdicts, solver: str) -> Verdict | None:
    """Return a solver's fastest configuration without faults, usual settings first; or None."""
    return next((v for v in rank_solvers(verdicts) if v.configuration.solver == solver), None)


def rank_solvers(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's fastest configuration without faults, the fastest solver first."""
    by_solver = group_by_key(
        rank_configurations(verdicts), lambda verdict: verdict.configuration.solver
    )
    return list(map(_choose_most_usual_of_fastest, by_solver.values()))


def _choose_most_usual_of_fastest(own: Sequence[Verdict]) -> Verdict:
    """Return of a solver's about equally fast configurations the one of most usual settings."""
    return min(list_equally_fast(own[0], own), key=_make_settings_sort_key)


@dataclass(frozen=True)
class BestSettings:
    """Best of a solver's settings, and the figure that it is best by.

    verdict : None if times are not ranked and the solver does not count iterations, or if none is
        accurate and none finished its runs.
    """

    verdict: Verdict | None
    by: Literal["time", "iterations", "error"]


def choose_best_settings(verdicts: Verdicts, points: Sequence[Verdict]) -> BestSettings:
    """Return the best of a solver's settings; of accurate ones by the limiting p99.

    By iterations if a disturbed machine can explain which one is the fastest.

    points : verdicts on custom settings of one solver.
    """
    best = min(points, key=make_sort_key_of_settings)
    if best.state not in ACCURATE:
        finished = [verdict for verdict in points if verdict.is_finished]
        return BestSettings(min(finished, key=make_sort_key_of_settings, default=None), "error")
    rivals = sorted((v for v in points if v.state == best.state), key=_make_settings_sort_key)
    if _is_ranking_withheld(rivals):
        counted = all(math.isfinite(verdict.iterations[0]) for verdict in rivals)
        fewest = min(rivals, key=lambda verdict: verdict.iterations)
        return BestSettings(fewest if counted else None, "iterations")
    fastest_first = sorted(rivals, key=find_ranking_time_ns)
    best = _choose_most_usual_of_fastest(fastest_first)
    ranked = find_fastest_configuration(verdicts, best.configuration.solver)
    if ranked is None or ranked.state != best.state:
        return BestSettings(best, "time")
    # Its call mode is the one recommended, which need not be that of the best verdict.
    is_of_best = ranked.configuration.options == best.configuration.options
    return BestSettings(ranked if is_of_best else best, "time")


def _is_ranking_withheld(rivals: Sequence[Verdict]) -> bool:
    """Return whether the spread of disturbed rounds can explain which settings are the fastest."""
    fastest, *others = sorted(rivals, key=find_ranking_time_ns)
    for other in others:
        spread = max(fastest.disturbed_spread, other.disturbed_spread)
        ratio = find_ranking_time_ns(other) / find_ranking_time_ns(fastest)
        if spread > 1.0 and Interval(ratio, ratio, ratio).is_within_spread(spread):
            return True
    return False


def list_equally_fast(best: Verdict, own: Sequence[Verdict]) -> list[Verdict]:
    """Return a solver's configurations that are as fast as its `best`, in the same call mode.

    Their times differ by less than `ALIKE`, or than the rounds of each do, up to `MOST_SPREAD`.
    """
    best_ns = find_ranking_time_ns(best)
    mode = best.configuration.route, best.configuration.policy
    return [
        verdict
        for verdict in own
        if (verdict.configuration.route, verdict.configuration.policy) == mode
        and find_ranking_time_ns(verdict) <= _find_largest_ratio_of_noise(best, verdict) * best_ns
    ]


def _find_largest_ratio_of_noise(one: Verdict, other: Verdict) -> float:
    """Return the ratio of two configurations' times up to which they are equally fast."""
    # Rounds are interleaved: other work on the machine spreads those of both.
    spread = min(slowest / fastest for fastest, slowest in (one.rounds_ns, other.rounds_ns))
    return max(1.0 + ALIKE, min(spread, MOST_SPREAD))


def _make_settings_sort_key(verdict: Verdict) -> tuple[int, tuple[str | float, ...]]:
    """Return a sort key of a verdict: the preset or the name of its settings."""
    return sort_key_of_settings(verdict.configuration.settings)


def find_ranking_time_ns(verdict: Verdict) -> float:
    """Return the time by which a configuration is ranked [ns]: limiting p99, p50, else ∞."""
    return next(filter(math.isfinite, (verdict.p99_ns, verdict.p50_ns)), math.inf)


@dataclass(frozen=True)
class SolverChoice:
    """Recommended solver configuration of a result folder, the runner-up, and any faster one.

    chosen : the fastest configuration that can be deployed; None where none qualifies.
    runner_up : the fastest one of another solver that can be.
    faster : the fastest of all, where that is another one; `because` is why it is not chosen.
    """

    chosen: Verdict | None
    runner_up: Verdict | None
    faster: Verdict | None
    because: str = ""


def choose_solver(verdicts: Verdicts) -> SolverChoice:
    """Return the fastest solver that passes and can be deployed, or none; and the runner-up.

    Where none does, those that are borderline are compared, else those that nothing contradicts.
    """
    known = rank_solvers(verdicts)
    met, near = ([v for v in known if v.state == name] for name in ("pass", "borderline"))
    candidates = met or near or known
    deployable = [v for v in candidates if not explain_deployment_blocker(v.configuration.solver)]
    chosen = deployable[0] if deployable else None
    faster = candidates[0] if candidates and candidates[0] is not chosen else None
    because = explain_deployment_blocker(faster.configuration.solver) if faster is not None else ""
    return SolverChoice(chosen, deployable[1] if deployable[1:] else None, faster, because)


def find_solver_record_or_none(solver: str) -> SolverRecord | None:
    """Return the description of a solver by its name; None if it is not known here."""
    try:
        return find_solver_record(solver)
    except UnknownNameError:
        return None


def find_solver_family(solver: str) -> str:
    """Return a solver's method family, as "active set"; "not stated" if unknown."""
    return str(getattr(find_solver_record_or_none(solver), "family", "not stated"))


def explain_deployment_blocker(solver: str) -> str:
    """Return why a solver cannot be deployed on a ship as it is; "" where it can."""
    known = find_solver_record_or_none(solver)
    return "not in the table of this installation" if known is None else known.reason_not_deployable


def select_run_in_both_modes(own: Sequence[Verdict]) -> Sequence[Verdict]:
    """Return the verdicts with a closed loop and a replay; all of them where none has both."""
    return [verdict for verdict in own if verdict.loops and verdict.replays] or own


def list_best_verdict_of_each_solver(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's best verdict, sorted by `sort_best_first`.

    Of its best state that of `rank_solvers`, else the best of those timed on most QP sequences, the
    fastest of equally good ones, the most usual settings of equally fast ones. Where some were run
    in both modes, those without a loop or a replay do not count.
    """
    fastest = {verdict.configuration.solver: verdict for verdict in rank_solvers(verdicts)}
    chosen = []
    for solver, own in verdicts.of.items():
        whole = select_run_in_both_modes(own)
        best = min(whole, key=lambda v: STATES.index(v.state)).state
        alike = [verdict for verdict in whole if verdict.state == best]
        if (first := fastest.get(solver)) not in alike:
            widest = max(verdict.replays for verdict in alike)
            wide = [verdict for verdict in alike if verdict.replays == widest]
            highest = min(map(_make_quality_sort_key, wide))
            equal = [verdict for verdict in wide if _make_quality_sort_key(verdict) == highest]
            first = _choose_most_usual_of_fastest(sort_fastest_first(equal))
        chosen.append(first)
    return sort_best_first(chosen)


def group_own_settings(verdicts: Verdicts) -> dict[tuple[str, str], list[Verdict]]:
    """Return the verdicts on custom settings, grouped by solver and options."""
    own = [verdict for verdict in verdicts.all_verdicts if verdict.configuration.options]
    return group_by_key(own, lambda v: (v.configuration.solver, v.configuration.options))


LEAST_POINTS = 3
"""Settings with the same options that count as a grid."""


def sort_points_of_grids_last(own: Sequence[Verdict]) -> list[Verdict]:
    """Return verdicts on custom settings, those that are points of a grid last."""
    grids = [
        (verdict.configuration.solver, *decode_options_from_json(verdict.configuration.options))
        for verdict in own
    ]
    points = Counter(grids)
    ordered = sorted(range(len(own)), key=lambda i: points[grids[i]] >= LEAST_POINTS)
    return [own[i] for i in ordered]


ACCURATE: tuple[State, ...] = ("pass", "borderline", "late")
"""Verdicts on configurations whose answers are right on every step."""


def list_best_verdict_of_own_settings(verdicts: Verdicts) -> list[Verdict]:
    """Return the best verdict over the call modes of each solver's custom settings.

    Only the call modes count that were judged in a closed loop and in the most runs of all.
    """
    return [_choose_of_most_judged(alike) for alike in group_own_settings(verdicts).values()]


def _choose_of_most_judged(alike: Sequence[Verdict]) -> Verdict:
    """Return the best of the verdicts that are of a closed loop, if any is, and of most runs."""
    judged = {v.configuration: (v.loops > 0, v.loops + v.replays + v.windows) for v in alike}
    most = max(judged.values())
    return sort_best_first(v for v in alike if judged[v.configuration] == most)[0]


def make_sort_key_of_settings(verdict: Verdict) -> tuple[int, float]:
    """Return a sort key: from pass to fail, then by limiting p99 if accurate, else by error."""
    figure = verdict.p99_ns if verdict.state in ACCURATE else verdict.error_move
    return STATES.index(verdict.state), figure if math.isfinite(figure) else math.inf


def list_main_verdicts(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's best verdict and `MOST_OWN` on custom settings, those in no grid first.

    They are sorted by `sort_best_first`.
    """
    best_first = sort_best_first(list_best_verdict_of_own_settings(verdicts))
    own = sort_points_of_grids_last(best_first)[:MOST_OWN]
    listed = {v.configuration: v for v in (*list_best_verdict_of_each_solver(verdicts), *own)}
    return sort_best_first(listed.values())

"""Solvers of controllers that command thrusters, beside those of three forces."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import isfinite, nan
from typing import Literal

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.verdict.requirements import (
    LATE,
    MISSED,
    STATES,
    Requirements,
    State,
    is_right_to_the_end,
)
from dpbench.analysis.verdict.verdict import Verdict, Verdicts, judge_solvers

TIME_FIELDS = (
    *("p50_ns", "p99_ns", "p99_interval", "p99_wait_ns", "p99_run", "timed_on", "rounds_ns"),
    *("replay_p99_ns", "raw_p99_ns", "longest_ns", "longest_run", "raw_max_ns", "of_sequences"),
)
"""Fields of a verdict that are step times, or name where they were measured."""

Fault = Literal["too late", "wrong", "too late or wrong"]


@dataclass(frozen=True)
class ThrusterVerdicts:
    """Verdicts on each solver where the MPC commands thrusters, and where three forces.

    forces : scenarios whose controller commands three forces.
    with_forces, with_thrusters : the best verdict on any configuration of each solver; the first
        is empty where the suite has no such scenario.
    faults : of the solvers that fail with thrusters, what contradicts it.
    """

    forces: tuple[str, ...]
    with_forces: dict[str, State]
    with_thrusters: dict[str, State]
    faults: dict[str, Fault]

    def list_solvers_with_state(self, *states: State) -> list[str]:
        """Return the solvers with one of these verdicts where the MPC commands thrusters."""
        return [name for name, state in self.with_thrusters.items() if state in states]

    @property
    def passing_with_forces(self) -> list[str]:
        """Names of solvers that pass with three forces and were also judged with thrusters."""
        known = self.with_thrusters
        return [s for s, state in self.with_forces.items() if state == "pass" and s in known]


def is_mostly_thruster_control(records: Records) -> bool:
    """Return whether the MPC commands thrusters in most scenarios run in closed loop."""
    loops = {
        run.scenario: run.commands_thrusters for run in records.select_runs(mode="closed_loop")
    }
    return 2 * sum(loops.values()) > len(loops)


@lru_cache(maxsize=2)
def judge_thruster_control(records: Records, requirements: Requirements) -> Verdicts:
    """Return verdicts on solvers by the runs alone in which the MPC commands thrusters."""
    runs = [run for run in records.runs if run.commands_thrusters]
    return judge_solvers(records, requirements, runs)


def has_times_of_both(records: Records) -> bool:
    """Return whether most loops command thrusters, and replays have QPs of both controllers."""
    replays = {run.commands_thrusters for run in records.select_runs(mode="replay")}
    return len(replays) == 2 and is_mostly_thruster_control(records)


def copy_with_thruster_times(
    records: Records, requirements: Requirements, verdict: Verdict
) -> Verdict:
    """Return a verdict with the step times of thruster QPs alone, in a folder about thrusters.

    Unchanged where most loops command forces, where all replays are of one kind, or where none of
    the configuration's replays has QPs of thrusters.
    """
    if not has_times_of_both(records):
        return verdict
    own = judge_thruster_control(records, requirements).of.get(verdict.configuration.solver, ())
    alike = [v for v in own if v.configuration == verdict.configuration and v.timed_on]
    if not alike:
        return verdict
    return replace(verdict, **{name: getattr(alike[0], name) for name in TIME_FIELDS})


def compare_thrusters_with_forces(records: Records, requirements: Requirements) -> ThrusterVerdicts:
    """Return verdicts on solvers where MPC commands thrusters and where three forces."""
    of_forces = [
        run for run in records.runs if run.scenario_documents and not run.commands_thrusters
    ]
    verdicts = judge_thruster_control(records, requirements)
    return ThrusterVerdicts(
        tuple(dict.fromkeys(run.scenario for run in of_forces)),
        _find_best_state_by_solver(judge_solvers(records, requirements, of_forces)),
        _find_best_state_by_solver(verdicts),
        {
            s: _name_common_fault(own)
            for s, own in verdicts.of.items()
            if _find_best_state(own) in MISSED
        },
    )


@dataclass(frozen=True)
class ThrusterControlLoops:
    """Closed loops in which the MPC commands thrusters, and each scenario's best loop.

    The best is right to the end, ran farthest and is nearest to the exact loop.
    """

    best: dict[str, RunRecord]
    configurations: dict[str, list[RunRecord]]


def select_thruster_control_loops(
    records: Records, requirements: Requirements
) -> ThrusterControlLoops:
    """Return loops that command thrusters by configuration, and each scenario's best loop."""
    loops = (run for run in records.select_runs(mode="closed_loop") if isfinite(run.power_share))
    runs = [run for run in loops if not run.is_baseline_law]
    right = [run for run in runs if is_right_to_the_end(run, requirements)]
    right.sort(key=lambda run: (run.scenario, -run.steps_done, run.dev_position_max_m))
    best = map_first_by_key(right, lambda run: run.scenario)
    known = (run for run in runs if run.scenario in best)
    configurations = group_by_key(
        known, lambda run: run.configuration.moved_to_common_formulation.label
    )
    return ThrusterControlLoops(best, configurations)


def find_largest_ratio_to_best(
    runs: Sequence[RunRecord], best: dict[str, RunRecord], column: str
) -> float:
    """Return the largest ratio of a loop's metric, as wear, to the best loop's; or NaN."""
    beside = ((getattr(run, column), getattr(best[run.scenario], column)) for run in runs)
    return max((own / least for own, least in beside if least > 0.0), default=nan)


def list_late_losses(run: RunRecord) -> list[str]:
    """Return the thrusters lost in a closed loop; empty unless all are in its second half."""
    scenario = (run.scenario_documents or {}).get("scenario", {})
    faults = [fault for fault in scenario.get("faults") or () if fault.get("lost")]
    if not faults:
        return []
    whole_s = scenario["sample_s"] * run.steps_done
    early = min(fault["at_s"] for fault in faults) < 0.5 * whole_s
    late = max(fault["at_s"] for fault in faults) >= whole_s
    return [] if early or late else [str(name) for fault in faults for name in fault["lost"]]


def _find_best_state_by_solver(verdicts: Verdicts) -> dict[str, State]:
    """Return the best verdict of each solver that was run."""
    states = {solver: _find_best_state(own) for solver, own in verdicts.of.items()}
    return {solver: state for solver, state in states.items() if state != "not run"}


def _find_best_state(own: Sequence[Verdict]) -> State:
    """Return the best of several verdicts as a word."""
    return min((verdict.state for verdict in own), key=STATES.index)


def _name_common_fault(own: Sequence[Verdict]) -> Fault:
    """Return why a solver fails in every configuration: answers wrong, late, or either."""
    causes = [{finding.kind for finding in v.causes} for v in own if v.state != "not run"]
    if all(kinds - {*LATE} for kinds in causes):
        return "wrong"
    return "too late" if all(kinds & {*LATE} for kinds in causes) else "too late or wrong"

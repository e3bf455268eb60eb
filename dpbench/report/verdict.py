"""Judge every solver by the suite's demand on its default route, policy fresh, from rows alone.

A solver *meets* the demand when every judged step of its closed loops and replays has
error_move within the demand, no more steps fail than it allows, and the p99 of its algorithmic
step time stays below the demand in every replayed sequence. What contradicts the demand makes
it *miss*; what merely could not be measured leaves it *open*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dpbench.report.demand import Demand
from dpbench.report.formats import and_list, as_float, error_text, plural, time_text
from dpbench.report.statistics import percentile, supports
from dpbench.report.view import Row, View

Outcome = Literal["meets", "misses", "open", "not run"]
NO_LOOP = "no closed loop was run"
NO_REPLAY = "no replay was run, so its time is not judged"
"""The doubt about a solver that has closed loops alone."""


@dataclass(frozen=True)
class Verdict:
    """The judgement of one solver at one settings level, policy fresh.

    Parameters
    ----------
    causes : why it misses the demand; doubts : what could not be judged. Plain clauses.
    steps : steps whose answers were judged; error_move : the largest error among them.
    p99_ns : worst p99 over the sequences that support one, `p99_of` the sequence.
    algo_max_ns : largest algorithmic step time over all sequences.
    """

    solver: str
    settings: str
    outcome: Outcome
    causes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    steps: int = 0
    error_move: float = math.nan
    failed_steps: int = 0
    p99_ns: float = math.nan
    p99_of: str = ""
    algo_max_ns: float = math.nan
    route: str = ""

    @property
    def policy(self) -> str:
        """The policy it is judged under."""
        return "fresh"

    @property
    def label(self) -> str:
        """What it is called beside others that are judged alike."""
        return self.solver

    def slowdown(self, demand: Demand) -> float:
        """How much slower a computer may be before the slowest step misses the deadline."""
        return demand.deadline_ns / self.algo_max_ns


def judge(view: View, solver: str, settings: str, demand: Demand) -> Verdict:
    """The verdict on one solver at one settings level."""
    loops = view.longest_loops(solver, settings, policy="fresh", default_route=True)
    replays = view.select(
        mode="replay",
        solver=solver,
        settings=settings,
        units="scaled",
        policy="fresh",
        default_route=True,
    )
    rows = [*loops, *replays]
    if not rows:
        return Verdict(solver, settings, "not run", doubts=("the suite does not run it so",))
    if all(row["outcome"] == "refused" for row in rows):
        return Verdict(solver, settings, "not run", doubts=(_detail(rows[0]),))
    causes = [*_wrong(rows, demand), *_failing(rows, demand)]
    doubts = _unfinished(rows)
    late, unsure, timing = _timing(view, replays, demand)
    causes += late
    doubts += unsure
    if not loops:
        doubts.append(NO_LOOP)
    if not replays:
        doubts.append(NO_REPLAY)
    outcome: Outcome = "misses" if causes else "open" if doubts else "meets"
    worst = np.array([as_float(row["error_move_max"]) for row in rows])
    known = worst[~np.isnan(worst)]
    return Verdict(
        solver,
        settings,
        outcome,
        tuple(causes),
        tuple(doubts),
        steps=sum(_judged(row) for row in rows),
        error_move=float(known.max()) if len(known) else math.nan,
        failed_steps=sum(_count(row, "failed_steps") for row in rows),
        route=str(rows[0]["route"]),
        **timing,
    )


def judge_all(view: View, demand: Demand) -> dict[str, list[Verdict]]:
    """Verdicts of all solvers by settings level, in the order of the levels of the suite."""
    levels = [str(row["settings"]) for row in view.runs if row["units"] == "scaled"]
    return {
        settings: [judge(view, solver, settings, demand) for solver in view.solvers]
        for settings in sorted(set(levels), key=settings_level)
    }


def settings_level(settings: str) -> tuple[int, str]:
    """Sort key of a settings level."""
    order = ("default", "low", "mid", "high")
    return (order.index(settings) if settings in order else len(order), settings)


def where(row: Row) -> str:
    """The place of a run in words."""
    if row["mode"] == "replay":
        return f"the replay of `{row['sequence']}`"
    return f"`{row['scenario']}`"


def _detail(row: Row) -> str:
    return str(row["outcome_detail"]).strip().rstrip(".") or "no reason was recorded"


def _count(row: Row, column: str) -> int:
    value = as_float(row[column])
    return int(value) if math.isfinite(value) else 0


def _judged(row: Row) -> int:
    return max(0, _count(row, "steps_done") - _count(row, "uncertified"))


def _wrong(rows: Sequence[Row], demand: Demand) -> list[str]:
    """Clauses about answers too far from the optimum, the worst run first."""
    off = [row for row in rows if as_float(row["error_move_max"]) > demand.error_move]
    silent = [row for row in off if math.isinf(as_float(row["error_move_max"]))]
    wrong = [row for row in off if row not in silent]
    clauses = []
    if silent:
        clauses.append(f"it leaves steps without an answer in {_places(silent)}")
    if wrong:
        worst = max(wrong, key=lambda row: as_float(row["error_move_max"]))
        others = [row for row in wrong if row is not worst]
        also = f" (over the demand also in {_places(others)})" if others else ""
        error = error_text(as_float(worst["error_move_max"]))
        clauses.append(
            f"its first move is up to {error} of a rate-limit step off the optimum in "
            f"{where(worst)}{also}"
        )
    return clauses


def _failing(rows: Sequence[Row], demand: Demand) -> list[str]:
    failing = [row for row in rows if _count(row, "failed_steps") > demand.failed_steps]
    if not failing:
        return []
    worst = max(failing, key=lambda row: as_float(row["failed_steps"]))
    rounds = max(1, _count(worst, "rounds"))
    of = plural(_count(worst, "steps_done") * rounds, "step")
    others = [row for row in failing if row is not worst]
    also = f" (some also in {_places(others)})" if others else ""
    return [f"{_count(worst, 'failed_steps')} of {of} fail in {where(worst)}{also}"]


def _places(rows: Sequence[Row]) -> str:
    loops = [f"`{row['scenario']}`" for row in rows if row["mode"] != "replay"]
    replays = [f"`{row['sequence']}`" for row in rows if row["mode"] == "replay"]
    if replays:
        word = "replay" if len(replays) == 1 else "replays"
        loops.append(f"the {word} of {' and '.join(replays)}")
    return and_list(loops)


def _unfinished(rows: Sequence[Row]) -> list[str]:
    """Clauses about runs that ended early or could not be judged."""
    doubts = []
    for row in rows:
        done, asked = _count(row, "steps_done"), _count(row, "steps_planned")
        if row["outcome"] == "timed_out" and row["mode"] == "replay" and done >= asked:
            # Every step has an answer and a time; fewer rounds make that time no smaller.
            continue
        if row["outcome"] == "timed_out":
            doubts.append(
                f"{where(row)} was stopped at its time limit ({done} of {plural(asked, 'step')})"
            )
        elif row["outcome"] != "finished":
            doubts.append(f"{where(row)} {row['outcome']}: {_detail(row)}")
        elif _count(row, "uncertified"):
            unsure = plural(_count(row, "uncertified"), "step")
            doubts.append(f"{unsure} of {where(row)} have no certified optimum")
    return doubts


def _timing(
    view: View, replays: Sequence[Row], demand: Demand
) -> tuple[list[str], list[str], dict[str, Any]]:
    """Clauses that contradict the time demand, clauses of doubt, and the figures behind."""
    late, unsure = [], []
    p99_ns, p99_of, algo_max_ns = math.nan, "", math.nan
    for row in replays:
        times = view.times(row)
        if times is None:
            if row["outcome"] == "finished":
                unsure.append(f"{where(row)} left no counting step")
            continue
        algo = times.algo_ns
        algo_max_ns = float(np.fmax(algo_max_ns, algo.max()))
        p99, p95 = percentile(algo, 99), percentile(algo, 95)
        if p99 == p99 and not p99 <= p99_ns:
            p99_ns, p99_of = p99, str(row["sequence"])
        if p99 > demand.p99_ns:
            late.append(f"its p99 is {time_text(p99)} in {where(row)}")
        elif p95 > demand.p99_ns:
            late.append(f"its p95 is already {time_text(p95)} in {where(row)}")
        elif not supports(len(algo), 99) and algo.max() > demand.p99_ns:
            steps = plural(len(algo), "step")
            unsure.append(
                f"{steps} of {where(row)} do not support a p99, and the slowest takes "
                f"{time_text(float(algo.max()))}"
            )
    return late, unsure, {"p99_ns": p99_ns, "p99_of": p99_of, "algo_max_ns": algo_max_ns}

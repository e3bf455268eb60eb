"""Who is fastest of all verdicts, and which one to use.

To use is the fastest that nothing contradicts and that can go aboard a ship. The fastest of all may
exist only as this benchmark's own Python code. It is named, and never recommended by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.verdict.verdict import OUTCOMES, Verdict, Verdicts
from dpbench.bench.record.configuration import settings_level
from dpbench.errors import UnknownNameError
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.table import record

ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""


def fastest_first(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """By p99, those without one by their largest step time, those without time last."""
    return sorted(
        verdicts,
        key=lambda v: (_known(v.p99_ns), _known(v.algo_max_ns), v.configuration.solver),
    )


def _known(time_ns: float) -> float:
    return time_ns if math.isfinite(time_ns) else math.inf


def ranked(verdicts: Verdicts) -> list[Verdict]:
    """The configurations that nothing is said against, timed on as many sequences as any; the
    fastest first, and of two names of one run the more usual settings."""
    ranks = [verdict for verdict in verdicts.all if verdict.ranks]
    widest = max((verdict.replays for verdict in ranks), default=0)
    wide = [verdict for verdict in ranks if verdict.replays == widest]
    return fastest_first(sorted(wide, key=_level))


def fastest_of(verdicts: Verdicts, solver: str) -> Verdict | None:
    """The fastest configuration of one solver, at its most usual settings where others are hardly
    faster."""
    return next((v for v in podium(verdicts) if v.configuration.solver == solver), None)


def podium(verdicts: Verdicts) -> list[Verdict]:
    """The fastest configuration of each solver, the fastest solver first."""
    by_solver = grouped(ranked(verdicts), lambda verdict: verdict.configuration.solver)
    return list(map(_most_usual, by_solver.values()))


def _most_usual(own: Sequence[Verdict]) -> Verdict:
    """Of one solver's verdicts, the fastest first: the most usual settings that are as fast."""
    best = own[0]
    alike = [
        verdict
        for verdict in own
        if verdict.configuration.route == best.configuration.route
        and verdict.configuration.policy == best.configuration.policy
        and (_figure(verdict) <= (1.0 + ALIKE) * _figure(best) or _rounds_overlap(verdict, best))
    ]
    return min(alike, key=_level)


def _rounds_overlap(a: Verdict, b: Verdict) -> bool:
    """Whether a round of either was as slow as one of the other: by chance the least of a few
    rounds may then be lower for the slower one."""
    return a.rounds_ns[0] <= b.rounds_ns[1] and b.rounds_ns[0] <= a.rounds_ns[1]


def _level(verdict: Verdict) -> tuple[int, str]:
    return settings_level(verdict.configuration.settings)


def _figure(verdict: Verdict) -> float:
    return verdict.p99_ns if math.isfinite(verdict.p99_ns) else verdict.p50_ns


@dataclass(frozen=True)
class Recommendation:
    """The answer of a result folder.

    Parameters
    ----------
    chosen : the fastest configuration that can be deployed; None where nobody qualifies.
    runner_up : the fastest one of another solver that can be.
    faster : the fastest of all, where that is another one; `because` says why it is not chosen.
    """

    chosen: Verdict | None
    runner_up: Verdict | None
    faster: Verdict | None
    because: str = ""


def recommend(verdicts: Verdicts) -> Recommendation:
    """The recommendation: by p99, among those that meet the demand.

    Where nobody can meet it, as the suite has no closed loop, those that nothing contradicts are
    compared; their outcome says that it is open.
    """
    open_or_met = podium(verdicts)
    candidates = [verdict for verdict in open_or_met if verdict.outcome == "meets"] or open_or_met
    aboard = [v for v in candidates if not why_not_aboard(v.configuration.solver)]
    chosen = aboard[0] if aboard else None
    faster = candidates[0] if candidates and candidates[0] is not chosen else None
    because = why_not_aboard(faster.configuration.solver) if faster is not None else ""
    return Recommendation(chosen, aboard[1] if aboard[1:] else None, faster, because)


def known_record(solver: str) -> SolverRecord | None:
    """The record of a solver; None for one that this installation does not know."""
    try:
        return record(solver)
    except UnknownNameError:
        return None


def family_of(solver: str) -> str:
    """The family of methods a solver belongs to; "not stated" of one that is not known here."""
    return str(getattr(known_record(solver), "family", "not stated"))


def why_not_aboard(solver: str) -> str:
    """Why a solver cannot go aboard as it is; "" where it can."""
    known = known_record(solver)
    return "not in the table of this installation" if known is None else known.why_not_aboard


def rescue(verdicts: Verdicts, reference: Verdict) -> Verdict | None:
    """The fastest configuration that meets the demand where a solver's reference does not."""
    if reference.outcome in ("meets", "not run"):
        return None
    meets = [v for v in verdicts.of[reference.configuration.solver] if v.outcome == "meets"]
    return next(iter(fastest_first(meets)), None)


def best_of_each(verdicts: Verdicts) -> list[Verdict]:
    """For each solver the fastest of its configurations that nothing is said against, else its
    reference; those that meet the demand first, then by time."""
    fastest = {verdict.configuration.solver: verdict for verdict in podium(verdicts)}
    chosen = [fastest.get(solver, own[0]) for solver, own in verdicts.of.items()]
    return sorted(fastest_first(chosen), key=lambda v: OUTCOMES.index(v.outcome))

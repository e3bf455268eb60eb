"""Which configuration to use: the fastest that nothing contradicts and that can go aboard a ship.

The fastest of all may exist only as this benchmark's own Python code. It is named, and never
recommended by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from dpbench.analysis.verdict import Verdict, Verdicts
from dpbench.errors import UnknownNameError
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.table import record


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
    podium = verdicts.podium
    meeting = [verdict for verdict in podium if verdict.outcome == "meets"]
    if meeting:
        podium = meeting
    aboard = [verdict for verdict in podium if not why_not_aboard(verdict.solver)]
    chosen = aboard[0] if aboard else None
    faster = podium[0] if podium and podium[0] is not chosen else None
    because = why_not_aboard(faster.solver) if faster is not None else ""
    return Recommendation(chosen, aboard[1] if aboard[1:] else None, faster, because)


def known_record(solver: str) -> SolverRecord | None:
    """The record of a solver; None for one that this installation does not know."""
    try:
        return record(solver)
    except UnknownNameError:
        return None


def why_not_aboard(solver: str) -> str:
    """Why a solver cannot go aboard as it is; "" where it can."""
    known = known_record(solver)
    return "not in the table of this installation" if known is None else known.why_not_aboard

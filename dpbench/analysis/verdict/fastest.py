"""Fastest configurations of all verdicts, and the one to use: the fastest that can be deployed.

The fastest of all may exist only as this benchmark's own Python code; it is named, not recommended.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.verdict.findings import STATES
from dpbench.analysis.verdict.verdict import Verdict, Verdicts
from dpbench.bench.record.cell import sort_key_of_settings
from dpbench.errors import UnknownNameError
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.table import find_solver_record

ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""
MOST_OWN = 12
"""Settings of one's own that are listed."""


def sort_fastest_first(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Sort verdicts on configurations by p99 step time, else the largest; untimed ones last."""
    return sorted(
        verdicts,
        key=lambda v: (
            *np.nan_to_num((v.p99_ns, v.algo_max_ns), nan=math.inf).tolist(),
            v.configuration.solver,
        ),
    )


def sort_best_first(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Sort verdicts on configurations from pass to fail, then by time."""
    return sorted(sort_fastest_first([*verdicts]), key=lambda v: STATES.index(v.state))


def rank_configurations(verdicts: Verdicts) -> list[Verdict]:
    """Return the configurations without faults timed on most QP sequences, fastest first.

    Of two names of one run the more usual settings.
    """
    ranks = [verdict for verdict in verdicts.all_verdicts if verdict.is_rankable]
    widest = max((verdict.replays for verdict in ranks), default=0)
    wide = [verdict for verdict in ranks if verdict.replays == widest]
    return sort_fastest_first(sorted(wide, key=_make_settings_sort_key))


def find_fastest_configuration(verdicts: Verdicts, solver: str) -> Verdict | None:
    """Return a solver's fastest configuration without faults, usual settings preferred."""
    return next((v for v in rank_solvers(verdicts) if v.configuration.solver == solver), None)


def rank_solvers(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's fastest configuration without faults, the fastest solver first."""
    by_solver = group_by_key(
        rank_configurations(verdicts), lambda verdict: verdict.configuration.solver
    )
    return list(map(_choose_most_usual_of_fastest, by_solver.values()))


def _choose_most_usual_of_fastest(own: Sequence[Verdict]) -> Verdict:
    """Return of a solver's about equally fast configurations the one of most usual settings."""
    best = own[0]
    mode = best.configuration.route, best.configuration.policy
    usual, (fastest, slowest) = (1.0 + ALIKE) * _choose_ranking_time_ns(best), best.rounds_ns
    alike = [
        verdict
        for verdict in own
        if (verdict.configuration.route, verdict.configuration.policy) == mode
        # Where rounds overlap, the least of a few may be lower for the slower one by chance.
        and (
            _choose_ranking_time_ns(verdict) <= usual
            or (verdict.rounds_ns[0] <= slowest and fastest <= verdict.rounds_ns[1])
        )
    ]
    return min(alike, key=_make_settings_sort_key)


def _make_settings_sort_key(verdict: Verdict) -> tuple[int, str]:
    """Return a sort key of a verdict: the tolerance level of its settings."""
    return sort_key_of_settings(verdict.configuration.settings)


def _choose_ranking_time_ns(verdict: Verdict) -> float:
    """Return the time by which a configuration is ranked [ns]: p99, else p50."""
    return verdict.p99_ns if math.isfinite(verdict.p99_ns) else verdict.p50_ns


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
    """Choose, of the solvers that pass and can be deployed, the one of smallest p99 step time.

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


def list_best_verdict_of_each_solver(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's best verdict, solvers sorted from pass to fail, then by time.

    Of its best state that of `rank_solvers`, else its reference, else the fastest. Where some were
    run in both modes, those without a loop or a replay do not count.
    """
    fastest = {verdict.configuration.solver: verdict for verdict in rank_solvers(verdicts)}
    chosen = []
    for solver, own in verdicts.of.items():
        whole = [verdict for verdict in own if verdict.loops and verdict.replays] or own
        best = min(whole, key=lambda v: STATES.index(v.state)).state
        alike = [verdict for verdict in whole if verdict.state == best]
        first = [v for v in (fastest.get(solver), own[0]) if v in alike]
        chosen.append((first or sort_fastest_first(alike))[0])
    return sort_best_first(chosen)


def group_own_settings(verdicts: Verdicts) -> dict[tuple[str, str], list[Verdict]]:
    """Group the verdicts on settings of one's own by solver and options."""
    own = [verdict for verdict in verdicts.all_verdicts if verdict.configuration.options]
    return group_by_key(own, lambda v: (v.configuration.solver, v.configuration.options))


def list_best_verdict_of_own_settings(verdicts: Verdicts) -> list[Verdict]:
    """Return the best verdict over the call modes of each solver's settings of one's own.

    Only the call modes count that were judged in a closed loop and in the most runs of all.
    """
    return [_choose_of_most_judged(alike) for alike in group_own_settings(verdicts).values()]


def _choose_of_most_judged(alike: Sequence[Verdict]) -> Verdict:
    """Return the best of the verdicts that are of a closed loop, if any is, and of most runs."""
    judged = {v.configuration: (v.loops > 0, v.loops + v.replays + v.windows) for v in alike}
    most = max(judged.values())
    return sort_best_first(v for v in alike if judged[v.configuration] == most)[0]


def list_main_verdicts(verdicts: Verdicts) -> list[Verdict]:
    """Return each solver's best verdict and the `MOST_OWN` best on settings of one's own.

    They are sorted from pass to fail, then by time.
    """
    own = sort_best_first(list_best_verdict_of_own_settings(verdicts))[:MOST_OWN]
    listed = {v.configuration: v for v in (*list_best_verdict_of_each_solver(verdicts), *own)}
    return sort_best_first(listed.values())

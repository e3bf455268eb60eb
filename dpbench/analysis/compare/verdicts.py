"""Configurations whose verdict differs between two result folders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dpbench.analysis.compare.pairs import Pair, Pairs
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import STATES, Requirements
from dpbench.analysis.verdict.verdict import Verdict, judge_solvers
from dpbench.bench.record.cell import Configuration


@dataclass(frozen=True, eq=False)
class VerdictChange:
    """Verdicts on one configuration in result folders A and B, which differ."""

    pair: Pair
    a: Verdict
    b: Verdict

    @property
    def is_for_the_worse(self) -> bool:
        """True if the verdict in B is the worse one."""
        return STATES.index(self.b.state) > STATES.index(self.a.state)


def find_verdict_changes(a: Records, b: Records, pairs: Pairs) -> list[VerdictChange]:
    """Return the configurations whose verdict changed, those that are worse in B first.

    Only runs that both folders have are judged, each by the requirements of its own suite. Without
    the steps of both folders nothing is compared.
    """
    if not (a.has_steps and b.has_steps):
        return []
    both = [*pairs.pairs, *pairs.refused, *pairs.repeated]
    in_a = _judge_paired_runs(a, [pair.a for pair in both])
    in_b = _judge_paired_runs(b, [pair.b for pair in both])
    found: dict[Configuration, VerdictChange] = {}
    for pair in both:
        key = pair.a.configuration.moved_to_common_formulation
        old, new = in_a.get(key), in_b.get(pair.b.configuration.moved_to_common_formulation)
        if old is not None and new is not None and old.state != new.state:
            found.setdefault(key, VerdictChange(pair, old, new))
    return sorted(found.values(), key=lambda change: not change.is_for_the_worse)


def _judge_paired_runs(
    records: Records, runs: Sequence[RunRecord]
) -> Mapping[Configuration, Verdict]:
    """Return the verdicts of a folder on those of the given runs that count in one."""
    paired = {run.run_id for run in runs}
    among = [run for run in records.runs if run.run_id in paired]
    verdicts = judge_solvers(records, Requirements.from_suite(records.suite), among)
    return {verdict.configuration: verdict for verdict in verdicts.all_verdicts}

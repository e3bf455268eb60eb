"""Claims of solvers on random problems, and what the referee found.

Every certified step of a configuration counts once:

    steps = true and claimed + claimed, not true + true, not claimed + rightly or wrongly called
            infeasible + no answer
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.bench.judge.rules import (
    NO_ANSWER_CLAIMS,
    mask_claimed_not_true,
    mask_decided_steps,
    mask_true_not_claimed,
)
from dpbench.bench.record.cell import sort_key_of_settings


@dataclass(frozen=True)
class Tally:
    """Counts of true and false solver claims, of an optimum or infeasibility, over QPs.

    steps : certified steps that were reached; missed : asked for and never reached.
    right_claims, false_claims : claimed, and true or not; not_claimed : true and not claimed.
    right_refusals, wrong_refusals : called infeasible or unbounded, rightly and wrongly.
    nothing : neither a claim nor a true answer.
    """

    steps: int
    right_claims: int
    false_claims: int
    not_claimed: int
    right_refusals: int
    wrong_refusals: int
    nothing: int
    missed: int

    @property
    def wrong_count(self) -> int:
        """Number of untrue claims, of an optimum or of infeasibility."""
        return self.false_claims + self.wrong_refusals


class RandomClaims:
    """True and false claims of optimality or infeasibility by solvers on all random QPs.

    `runs` are those that were not refused, each once: settings without effect, one run shown under
    several names, are one run with all of them in `settings`.
    """

    def __init__(self, records: Records) -> None:
        self.runs = _merge_equal_runs([run for run in records.random if run.outcome != "refused"])
        ids = [run.run_id for run in self.runs]
        tables = [
            count_claims_by_run(table[table["counts"]])
            for table in records.yield_step_tables(self.runs, ("run_id", "counts", *CLAIMS))
        ]
        names = [field.name for field in fields(Tally) if field.name != "missed"]
        counts = pd.concat(tables) if tables else pd.DataFrame(columns=names, dtype=np.int64)
        counts = counts.reindex(ids, fill_value=0)
        self._counts = counts.assign(missed=[r.steps_planned - r.steps_done for r in self.runs])

    def sum_tallies_by_columns(self, *names: str) -> dict[tuple[str, ...], Tally]:
        """Return counts of true and false claims, summed over runs equal in given columns."""
        keys = [tuple(str(getattr(run, name)) for name in names) for run in self.runs]
        sums = self._counts.groupby(pd.Index(keys, tupleize_cols=False), sort=False).sum()
        tallies = [Tally(*counts) for counts in sums.to_numpy(dtype=int).tolist()]
        return dict(zip(dict.fromkeys(keys), tallies, strict=True))


def _merge_equal_runs(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return runs, those merged into one that were measured once for several settings names."""
    kept: list[RunRecord] = []
    for own in group_by_key(runs, lambda run: replace(run.configuration, settings="")).values():
        by_level = group_by_key(own, lambda run: run.settings)
        for alike in group_by_key(
            by_level.items(), lambda level: _make_measurement_key(level[1])
        ).values():
            shown = ", ".join(sorted((settings for settings, _ in alike), key=sort_key_of_settings))
            kept += [replace(run, settings=shown) for run in alike[0][1]]
    return kept


def _make_measurement_key(runs: Sequence[RunRecord]) -> str:
    """Return a text that is equal for lists of runs with the same measured values."""
    return repr(sorted((run.sequence, run.raw_max_ns, run.steps_done) for run in runs))


CLAIMS = ("status", "certificate", "claimed", "true")


def count_claims_by_run(steps: pd.DataFrame) -> pd.DataFrame:
    """Return a table of each run's numbers of true and false claims (optimal, infeasible)."""
    return flag_claims_by_step(steps).groupby(steps["run_id"]).sum()


def flag_claims_by_step(steps: pd.DataFrame) -> pd.DataFrame:
    """Return a table of steps with a Boolean column per kind of true or false claim."""
    known, none_said = mask_decided_steps(steps), steps["status"].isin(NO_ANSWER_CLAIMS)
    claimed, true = steps["claimed"], steps["true"]
    return pd.DataFrame(
        {
            "steps": known,
            "right_claims": known & claimed & true,
            "false_claims": mask_claimed_not_true(steps),
            "not_claimed": mask_true_not_claimed(steps),
            "right_refusals": known & none_said & true,
            "wrong_refusals": known & none_said & ~true,
            "nothing": known & ~claimed & ~none_said & ~true,
        },
        index=steps.index,
    )

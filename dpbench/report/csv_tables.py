"""Everything the page shows, as tables, and what it has no room for: `tables/*.csv`, and the
data frames of `load_results`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from dpbench.analysis.run_steps import MEASURES, hardest
from dpbench.analysis.times.fastest import best_of_each, fastest_first
from dpbench.analysis.times.pairs import paired_comparison
from dpbench.bench.record.result_folder import Results
from dpbench.report.page.answer import Answer
from dpbench.report.page.facts import Facts
from dpbench.report.page.tables import ladder_table, matrix_table
from dpbench.report.page.topic import Topic
from dpbench.report.topics.trust import calling_ns


def tables_of(
    results: Results, facts: Facts, answer: Answer, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """All tables by name; one that has nothing to say has no row.

    runs : every run; verdicts : every configuration; places : every solver in every scenario and
    sequence; hard_steps : of every run; ladder, paired_ratios : the best configuration of every
    solver that was timed; those of a topic of the page have its name.
    """
    tables = {
        "runs": results.runs.drop(columns="cell"),
        "verdicts": _verdicts(facts, answer),
        "places": matrix_table(facts),
        "hard_steps": _hard_steps(facts),
        "ladder": ladder_table(facts, calling_ns(facts.records)).drop(columns="id"),
        "paired_ratios": _paired_ratios(facts),
    }
    for topic in topics:
        for i, small in enumerate(topic.tables):
            name = topic.id if i == 0 else f"{topic.id}_{i + 1}"
            tables[name] = pd.DataFrame(small.rows, columns=list(small.head))
    return tables


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write those that have rows into `folder`; those of an earlier report go."""
    folder.mkdir(exist_ok=True)
    for stale in folder.glob("*.csv"):
        stale.unlink()
    for name, table in tables.items():
        if len(table):
            table.to_csv(folder / f"{name}.csv", index=False)


def _verdicts(facts: Facts, answer: Answer) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "solver": v.configuration.solver,
                "route": v.configuration.route,
                "policy": v.configuration.policy,
                "settings": v.configuration.settings,
                "outcome": v.outcome,
                "why": answer.why(v),
                "closed_loops": v.loops,
                "replays": v.replays,
                "steps": v.steps,
                "error_move": v.error_move,
                "failed_steps": v.failed_steps,
                "p50_ns": v.p50_ns,
                "p99_ns": v.p99_ns,
                "algo_max_ns": v.algo_max_ns,
                "raw_max_ns": v.raw_max_ns,
                "timed_on": v.timed_on,
            }
            for v in facts.verdicts.all
        ]
    )


def _hard_steps(facts: Facts) -> pd.DataFrame:
    """The five hardest steps of every run by each measure."""
    labels = {run.run_id: facts.configurations[c].label for (c, _), run in facts.runs.items()}
    rows = [
        {
            "run_id": run_id,
            "configuration": labels[run_id],
            "by": measure,
            "k": int(steps.k[hard.at]),
            "value": hard.value,
            "status": str(steps.status[hard.at]),
            "claimed": bool(steps.claimed[hard.at]),
            "true": bool(steps.true[hard.at]),
            "n_active": int(steps.n_active[hard.at]),
        }
        for run_id, steps in facts.steps.items()
        if run_id in labels
        for measure in MEASURES
        for hard in hardest(steps, measure)
    ]
    return pd.DataFrame(rows)


def _paired_ratios(facts: Facts) -> pd.DataFrame:
    """How many times as long each solver's best configuration takes as the fastest of them, step
    by step, with the interval of the mean."""
    timed = fastest_first([v for v in best_of_each(facts.verdicts) if v.timed_on])
    rows = []
    for verdict in timed[1:]:
        pair = paired_comparison(facts.records, timed[0], verdict)
        rows.append(
            {
                "first": pair.first,
                "second": pair.second,
                "ratio": pair.ratio.value,
                "low": pair.ratio.low,
                "high": pair.ratio.high,
                "steps": pair.steps,
                "tied": pair.tied,
                "unstable": pair.unstable,
            }
        )
    return pd.DataFrame(rows)

"""Everything the page shows, as tables, and what it has no room for: `tables/*.csv` with a legend,
and the data frames of `load_results`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from dpbench.analysis.times.solver_tables import (
    hard_step_table,
    ratio_table,
    tile_table,
    time_table,
    verdict_table,
)
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.report.page.answer import Answer
from dpbench.report.page.facts import Facts
from dpbench.report.page.topic import Topic

LEGEND = "README.md"
TABLES = {
    "runs": "Every run as in `runs.parquet`, without its description: a solver in a place.",
    "verdicts": "Every configuration, held against the demand over all its runs.",
    "places": "Every solver in every place at every settings level, in the way it is judged by: "
    "the tiles of the page.",
    "hard_steps": "The five hardest steps of every run outside studies, by time, iterations and "
    "error.",
    "ladder": "The best configuration of every solver that was timed, the fastest p99 first.",
    "paired_ratios": "How many times as long these take as the first of them, step by step.",
}
COLUMNS = {
    "outcome": "against the demand: meets, misses, open or not run",
    "why": "what contradicts it, or was left open",
    "closed_loops": "loops it steered a ship in",
    "replays": "sequences it was timed on",
    "steps": "steps of them all, or that both have done",
    "error_move": "largest error of the first move, in rate-limit steps",
    "failed_steps": "steps without a usable answer",
    "p50_us": "median over steps of the step time, the least over rounds",
    "p99_us": "the same, 99 %; empty below 1000 steps",
    "max_us": "the same, largest",
    "raw_max_us": "largest single timing: the machine's jitter is in it",
    "longest_us": "the same of all that was judged, closed loops too",
    "share": "part of the median that an empty call takes",
    "timed_on": "the sequence of these times",
    "place": "a scenario or a replay, as on the page",
    "state": "against the demand: meets, open, late, wrong or not run; of a place, what its run "
    "alone says",
    "error": "largest error of the first move there, in rate-limit steps",
    "failed": "failed steps there",
    "id": "number of the configuration within this page; -1: not run",
    "place_id": "number of the place within this page",
    "detail": "why it misses or is open",
    "run_id": "the run, as in `runs.csv` and `steps.parquet`",
    "configuration": "solver, way and settings",
    "label": "solver, way and settings",
    "by": "what the step is hard by",
    "k": "the step, as in `steps.parquet`",
    "value": "by time its least over rounds in µs; iterations; or the error of the first move",
    "status": "what the solver said",
    "claimed": "it claimed to have solved the step",
    "true": "the referee found its answer true",
    "n_active": "active limits of the optimum",
    "ratio": "times as long `second` takes as `first`: geometric mean, replays of equal weight",
    "low": "lower end of its 95 % interval",
    "high": "upper end",
    "tied": "the interval holds 1",
    "unstable": "another yardstick names another leader",
}
RUN_MEANINGS = {name: meaning for name, (_, meaning) in RUN_COLUMNS.items()}


def tables_of(
    results: Results, facts: Facts, answer: Answer, topics: Sequence[Topic]
) -> dict[str, pd.DataFrame]:
    """All tables by name; one that has nothing to say has no row.

    `TABLES` says what each is; those of a topic of the page have its name.
    """
    tables = {
        "runs": results.runs.drop(columns="cell"),
        "verdicts": _verdicts(facts, answer),
        "places": tile_table(facts),
        "hard_steps": hard_step_table(facts, facts.kept),
        "ladder": _ladder(facts),
        "paired_ratios": ratio_table(facts),
    }
    for topic in topics:
        for i, small in enumerate(topic.tables):
            name = topic.id if i == 0 else f"{topic.id}_{i + 1}"
            tables[name] = small.frame
    return tables


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write those that have rows into `folder`, and what they say into `README.md`; those of an
    earlier report go."""
    folder.mkdir(exist_ok=True)
    for stale in folder.glob("*.csv"):
        stale.unlink()
    written = {name: table for name, table in tables.items() if len(table)}
    for name, table in written.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    (folder / LEGEND).write_text(_legend(written), encoding="utf-8")


def _legend(tables: Mapping[str, pd.DataFrame]) -> str:
    """What each table holds, and what its columns mean in which unit."""
    parts = [
        "# Tables of the page\n\nThe end of a name is its unit: `_ns` nanoseconds, `_us` "
        "microseconds as on the page, `_m`, `_s`, `_deg`, `_N`, `_bytes`. An empty field has no "
        "value. A place is called as on the page: a scenario, or a replay such as "
        "`rough[900:1400] (replay)`, steps 900 to 1400 of `rough`."
    ]
    for name, table in tables.items():
        known = RUN_MEANINGS if name == "runs" else COLUMNS
        lines = [f"- `{c}`: {known[c]}" for c in table.columns if c in known]
        head = f"## {name}.csv\n\n{TABLES.get(name, 'A table of a part of the page.')}"
        parts.append(head + ("\n\n" + "\n".join(lines) if lines else ""))
    return "\n\n".join(parts) + "\n"


def _ladder(facts: Facts) -> pd.DataFrame:
    """The ladder in microseconds, as the page says them; the figure's axis has milliseconds."""
    table = time_table(facts).drop(columns="id")
    times = [name for name in table.columns if name.endswith("_ms")]
    table[times] = 1e3 * table[times]
    return table.rename(columns={name: f"{name.removesuffix('_ms')}_us" for name in times})


def _verdicts(facts: Facts, answer: Answer) -> pd.DataFrame:
    """The verdicts with why they are so, in words."""
    table = verdict_table(facts)
    if len(table):
        why = [answer.why(verdict) for verdict in facts.verdicts.all]
        table.insert(list(table).index("outcome") + 1, "why", why)
    return table

"""`report.md`, short enough for a pull request: recommendation, one table, conditions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dpbench.analysis.verdict.fastest import best_of_each
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.result_folder import Results
from dpbench.report.escaped import markdown_line, markdown_text
from dpbench.report.formats import MISSING, error_text, rounded_down, time_text
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.table import markdown

MOST_BYTES = 8000
"""A comment on a pull request is read when it is one screen or two."""
HEAD = (
    *(
        "solver",
        "call mode",
        "verdict",
        "p50",
        "p99",
        "p99 of timings",
        "worst p99",
        "hardest step",
    ),
    *("speed margin", "largest error", "failed"),
)


def report_markdown(
    results: Results, data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> str:
    """Return the report in Markdown, at most `MOST_BYTES` long."""
    suite = results.suite
    lead = [topic.lines[0] for topic in topics if topic.leads]
    said = (
        [recommendation.sentence, *(note for _, note in recommendation.notes)]
        if data.verdicts.of or not lead
        else []
    )
    valid = ", ".join(chip.text for chip in recommendation.chips)
    after = [f"Valid for: {valid}."] if valid else []
    after += [recommendation.requirements, recommendation.machine]
    after += [f"{topic.title}: {topic.lines[0]}" for topic in topics if not topic.leads]
    parts = [
        f"# dpbench: {markdown_text(str(suite.get('name', 'results')))}",
        *map(markdown_line, [*lead, *said]),
        solver_table(data, best_of_each(data.verdicts)),
        *map(markdown_line, after),
    ]
    parts.append(
        "Everything else: `report.html` (figures, every step), `tables/*.csv`, `figures/*.svg`, "
        "`runs.parquet`, `steps.parquet`."
    )
    text = "\n\n".join(part for part in parts if part) + "\n"
    return cut(text, MOST_BYTES, "tables/verdicts.csv")


def solver_table(data: PageData, verdicts: Iterable[Verdict]) -> str:
    """Return a Markdown row for each configuration; empty without one."""
    rows = solver_rows(data, verdicts)
    return markdown(HEAD, rows, 3) if rows else ""


def solver_rows(data: PageData, verdicts: Iterable[Verdict]) -> list[tuple[str, ...]]:
    """Return a row for each configuration, under `HEAD`."""
    return [
        (
            verdict.configuration.solver,
            verdict.configuration.options,
            verdict.state,
            time_text(verdict.p50_ns),
            time_text(verdict.replay_p99_ns),
            time_text(verdict.raw_p99_ns),
            time_text(verdict.p99_ns),
            time_text(verdict.algo_max_ns),
            MISSING if margin is None else f"× {rounded_down(margin.factor)}",
            error_text(verdict.error_move),
            str(verdict.failed_steps),
        )
        for verdict in verdicts
        for margin in [data.margin(verdict.configuration)]
    ]


def cut(text: str, most_bytes: int, elsewhere: str) -> str:
    """Whole lines up to the limit; what is cut off is in `elsewhere`."""
    raw = text.encode()
    if len(raw) <= most_bytes:
        return text
    kept = raw[: most_bytes - 60].decode(errors="ignore").rsplit("\n", 1)[0]
    return f"{kept}\n\nMore rows: `{elsewhere}`.\n"

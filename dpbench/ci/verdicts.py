"""Verdicts on the benchmarks of two revisions, on the terminal and in Markdown."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table as ScreenTable
from rich.text import Text

from dpbench.analysis.statistics import Interval
from dpbench.ci.benchmarks import WRONG_ANSWERS
from dpbench.report.formats import plural
from dpbench.report.table import Table, escape_markdown_paragraph, make_markdown_table

NOT_TIMED, SLOWER, WORSE, GONE = "failed, not timed", "slower", "worse", "gone"
DISTURBED, NO_KERNEL, NOT_VERIFIED = "disturbed", "no reference kernel", "faster, not verified"
FASTER, NO_CHANGE, NEW, NO_BASELINE = "faster", "no change shown", "new", "no baseline"
REGRESSIONS = (WRONG_ANSWERS, NOT_TIMED, SLOWER, WORSE, GONE)
"""Verdicts that are a regression, the gravest first."""
ORDER = (*REGRESSIONS, DISTURBED, NO_KERNEL, FASTER, NOT_VERIFIED, NO_CHANGE, NEW, NO_BASELINE)
"""All verdicts, in the order in which they head a comparison."""
MEANINGS = {
    WRONG_ANSWERS: "answers beyond the requirements of the test",
    NOT_TIMED: "a test failed before it was timed",
    WORSE: "an exact measure grew",
    GONE: "a benchmark of the base was not run",
    DISTURBED: "other load disturbed the machine, no verdict on times",
    NO_KERNEL: "too few benchmarks of other solvers, no verdict on times",
    NOT_VERIFIED: "a smaller time, but not every answer is verified",
    NEW: "the base has no such benchmark",
    NO_BASELINE: "the base has no benchmark, nothing compared",
}


@dataclass(frozen=True)
class Row:
    """Verdict on one benchmark, ratio of its times with interval, and what explains it."""

    name: str
    verdict: str
    ratio: Interval | None = None
    remarks: tuple[str, ...] = ()

    @property
    def cells(self) -> dict[str, str]:
        """Row of the table, as text by head."""
        number = "–"
        if self.ratio is not None and np.isfinite(self.ratio.value):
            number = f"{self.ratio.value:.2f}"
            if np.isfinite(self.ratio.high):
                number += f" [{self.ratio.low:.2f}, {self.ratio.high:.2f}]"
        remarks = "; ".join(self.remarks)
        return {
            "benchmark": self.name,
            "verdict": self.verdict,
            "ratio": number,
            "remarks": remarks,
        }


@dataclass(frozen=True)
class RunComparison:
    """Verdicts on all benchmarks of two revisions."""

    rows: list[Row]
    allow_gone: bool = False

    @property
    def verdict(self) -> str:
        """Gravest verdict of all benchmarks."""
        found = {row.verdict for row in self.rows}
        if self.allow_gone and len(found) > 1:
            found.discard(GONE)
        return next((one for one in ORDER if one in found), NO_BASELINE)

    @property
    def worse(self) -> bool:
        """True if a regression is shown."""
        return self.verdict in REGRESSIONS and not (self.allow_gone and self.verdict == GONE)

    @property
    def headline(self) -> str:
        """Verdict, what it means, and how many benchmarks have which verdict."""
        meaning = MEANINGS.get(self.verdict, "")
        counts = Counter(row.verdict for row in self.rows)
        text = f"{self.verdict}{f' ({meaning})' if meaning else ''}"
        if len(counts) > 1:
            return f"{text}: {', '.join(f'{counts[one]} {one}' for one in ORDER if counts[one])}"
        return f"{text}: {plural(len(self.rows), 'benchmark')}"

    @property
    def table(self) -> Table | None:
        """A row for each benchmark; None without any."""
        return (
            Table.from_rows([row.cells for row in self.rows], text_columns=4) if self.rows else None
        )

    def markdown(self, lines: Iterable[str] = ()) -> str:
        """Return a Markdown document that begins with the verdict."""
        parts = [f"**dpbench: {escape_markdown_paragraph(self.headline)}**"]
        if self.table is not None:
            parts.append(make_markdown_table(self.table.heads, self.table.rows, 4))
        return "\n\n".join([*parts, *map(escape_markdown_paragraph, lines)]) + "\n"

    def print(self, console: Console, lines: Iterable[str] = ()) -> None:
        """Print the verdict, a row for each benchmark, and lines below them."""
        console.print(self.headline, markup=False, highlight=False, soft_wrap=True)
        if self.table is not None:
            shown = ScreenTable(show_edge=False, pad_edge=False)
            for head in self.table.heads:
                shown.add_column(head, overflow="fold")
            for row in self.table.rows:
                shown.add_row(*map(Text, row))
            console.print(shown)
        for line in lines:
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def describe_end(found: RunComparison, against: str) -> str:
    """State in one line whether a regression against a baseline is shown."""
    return f"{'a regression' if found.worse else 'no regression shown'} against {against}"

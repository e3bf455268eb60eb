"""The progress bar of the command line."""

from __future__ import annotations

import sys
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Bar:
    """A progress bar with the time left, fed by the campaign; a transient one leaves no line, a
    quiet one shows nothing."""

    def __init__(self, *, transient: bool = False, quiet: bool = False) -> None:
        self._quiet = quiet
        self._progress = Progress(
            TextColumn("{task.description:<44}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            transient=transient,
            disable=quiet or (transient and not _can_erase()),
        )
        self._task = self._progress.add_task("starting", total=None)

    def __enter__(self) -> Bar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._progress.live.is_started:
            self._progress.stop()

    def start(self, work: int) -> None:
        """So much is to be done; until now the input could still be refused, without a bar."""
        self._progress.start()
        self._progress.update(self._task, total=work)

    def remark(self, text: str) -> None:
        """A line above the bar; beside the output where there is none, unless it is quiet."""
        if not self._progress.disable:
            self._progress.console.print(f"dpbench: {text}", highlight=False)
        elif not self._quiet:
            print(f"dpbench: {text}", file=sys.stderr)

    def advance(self, work: int, what: str) -> None:
        """So much is done now, the last of it on `what`."""
        self._progress.update(self._task, advance=work, description=what[:44])


def _can_erase() -> bool:
    """Whether standard output is a terminal that can take back what was printed."""
    console = Console()
    return console.is_terminal and not console.is_dumb_terminal

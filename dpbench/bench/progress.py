"""Receivers of the progress of a campaign."""

import sys
import time
from typing import Protocol

MINUTE_S, SHORTEST_S, SHARE = 60.0, 10.0, 0.1
"""`ProgressLines` prints each minute, and a tenth or a stage at the end that takes `SHORTEST_S`."""


class Progress(Protocol):
    """Receiver of a campaign's progress, such as a progress bar; `work` is in solver steps."""

    def start(self, work: int) -> None:
        """Set a campaign's total work [solver steps]."""

    def advance(self, work: int, what: str) -> None:
        """Add finished work [steps]; `what` names the latest part of it."""

    def remark(self, text: str) -> None:
        """Show a remark of a campaign to the user."""

    def waiting(self, text: str) -> None:
        """Show why the campaign waits, even where the progress is silent otherwise."""


class Silent:
    """A progress receiver that shows nothing."""

    def _ignore_report(self, *_: object, **__: object) -> None:
        """Show nothing, whatever progress or remark a campaign reports."""

    start = advance = remark = waiting = _ignore_report


class ProgressLines:
    """A progress receiver that prints lines on standard error, without a terminal's control."""

    def __init__(self) -> None:
        self.start(0)

    def start(self, work: int) -> None:
        """Begin to count time and work; nothing is printed yet."""
        self._total, self._done, self._printed_share = work, 0, 0.0
        self._printed_s = self._started_s = time.monotonic()

    def advance(self, work: int, what: str) -> None:
        """Add finished work; print how much is done each minute, and each tenth that takes long.

        After all work also what takes long at the end, such as writing the tables and the report.
        """
        self._done += work
        share, now_s = self._done / self._total if self._total else 1.0, time.monotonic()
        is_due = share >= 1.0 or share - self._printed_share >= SHARE
        if now_s - self._printed_s >= (SHORTEST_S if is_due else MINUTE_S):
            lead = f"{100 * share:.0f} %" if work or share < 1.0 else "all steps done"
            after = f"{lead} after {now_s - self._started_s:.0f} s"
            self.remark(f"{after}: {what}" if what else after)
            self._printed_s, self._printed_share = now_s, share

    def remark(self, text: str) -> None:
        """Print a remark of a campaign."""
        print(f"dpbench: {text}", file=sys.stderr, flush=True)

    waiting = remark


def choose_progress(progress: Progress | bool | None) -> Progress:
    """Return a receiver of progress: the given one, or one that prints (True) or is silent (False).

    None is True where somebody looks on: in a terminal or a notebook.
    """
    if progress is None:
        progress = sys.stderr.isatty() or "ipykernel" in sys.modules
    if isinstance(progress, bool):
        return ProgressLines() if progress else Silent()
    return progress

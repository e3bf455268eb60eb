"""Receivers of the progress of a campaign."""

from typing import Protocol


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

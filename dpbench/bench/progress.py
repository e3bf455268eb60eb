"""Receivers of the progress of a campaign."""

from typing import Protocol


class Progress(Protocol):
    """Receiver of a campaign's progress, such as a progress bar; `work` is in solver steps."""

    def start(self, work: int) -> None:
        """Set a campaign's total work [solver steps]."""

    def advance(self, work: int, what: str) -> None:
        """Add finished work [steps]; `what` names the latest part of it."""

    def remark(self, text: str) -> None:
        """Show a remark to the user."""

    def waiting(self, text: str) -> None:
        """Show why the campaign waits, even where the progress is silent otherwise."""


class Silent:
    """A progress receiver that shows nothing."""

    def start(self, work: int) -> None:
        """Ignore the total work."""

    def advance(self, work: int, what: str) -> None:
        """Ignore finished work."""

    def remark(self, text: str) -> None:
        """Ignore a remark."""

    def waiting(self, text: str) -> None:
        """Ignore the reason of a wait."""

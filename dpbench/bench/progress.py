"""Receivers of the progress of a campaign."""

from typing import Protocol


class Progress(Protocol):
    """Receiver of the progress of a campaign; `work` is in steps."""

    def start(self, work: int) -> None:
        """Set the work to do."""

    def advance(self, work: int, what: str) -> None:
        """Add finished work, the last of it on `what`."""

    def remark(self, text: str) -> None:
        """Show a remark."""

    def waiting(self, text: str) -> None:
        """Show the reason of a wait, even where all else is silent."""


class Silent:
    """A progress that shows nothing."""

    def start(self, work: int) -> None:
        """Show nothing."""

    def advance(self, work: int, what: str) -> None:
        """Show nothing."""

    def remark(self, text: str) -> None:
        """Show nothing."""

    def waiting(self, text: str) -> None:
        """Show nothing."""

"""Who is told how far a long work is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Who is told how far a campaign is; `work` is in steps."""

    def start(self, work: int) -> None:
        """So much is to be done."""

    def advance(self, work: int, what: str) -> None:
        """So much is done now, the last of it on `what`."""

    def remark(self, text: str) -> None:
        """Something worth knowing before it goes on."""

    def waiting(self, text: str) -> None:
        """What it waits for, shown even where all else is silent."""


class Silent:
    """A progress that shows nothing."""

    def start(self, work: int) -> None:
        """Show nothing."""

    def advance(self, work: int, what: str) -> None:
        """Show nothing."""

    def remark(self, text: str) -> None:
        """Say nothing."""

    def waiting(self, text: str) -> None:
        """Say nothing."""

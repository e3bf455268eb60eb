"""What a controller's author asks about a solver next, as its own documentation answers it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fact:
    """A statement and where the project makes it, in words; no source, no statement."""

    value: str = "not stated"
    source: str = ""


@dataclass(frozen=True)
class Project:
    """Facts about a solver's project.

    Parameters
    ----------
    licence, language : of the solver itself, not of its Python interface.
    c_code : whether it generates C code for a problem, or is C code one can embed.
    allocation_free : whether a solve after set-up allocates no memory.
    single_precision : whether it can be built in single precision.
    """

    licence: Fact = Fact()
    language: Fact = Fact()
    c_code: Fact = Fact()
    allocation_free: Fact = Fact()
    single_precision: Fact = Fact()


NOT_STATED = Project()

"""The record of one solver: what it is, in which form it gets its matrices, what it can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from dpbench.solvers.contract import Policy, Route

Form = Literal["dense", "csc"]
Box = Literal["native", "rows"]
Start = Literal["none", "primal", "active set"]
Extra = Literal["core", "solvers", "jax", "own"]


@dataclass(frozen=True)
class SolverRecord:
    """One row of the table of solvers.

    Parameters
    ----------
    name : its name in dpbench; `qpsolvers_name` where qpsolvers calls it otherwise.
    distribution, module : what `pip` installs and what Python imports; "" for dpbench's own.
    method : the algorithm, in a line.
    extra : which part of dpbench's dependencies brings it; "own" needs nothing.
    form : the form its matrices are kept in, its own fastest.
    box : whether bounds reach it as bounds, or as rows prepared once because qpsolvers would
        otherwise append an identity matrix at every solve.
    policies : the policies of each route.
    refused : why a policy of a route is not there, where there is more to say than that.
    start : what a warm start is made of.
    needs_strict_convexity : whether P has to be positive definite.
    gives_multipliers : whether y and y_box come back.
    detects_infeasibility : whether an infeasible problem is reported as such, and not only as
        "no answer".
    """

    name: str
    distribution: str
    module: str
    method: str
    extra: Extra
    form: Form
    box: Box
    policies: Mapping[Route, tuple[Policy, ...]]
    start: Start = "none"
    needs_strict_convexity: bool = False
    gives_multipliers: bool = True
    detects_infeasibility: bool = True
    qpsolvers_name: str = ""
    refused: Mapping[tuple[Route, Policy], str] = field(default_factory=dict)

    @property
    def default_route(self) -> Route:
        """The route taken when none is asked for."""
        return next(iter(self.policies))

    @property
    def remedy(self) -> str:
        """The command that installs it."""
        extra = "" if self.extra in ("core", "own") else f"[{self.extra}]"
        return f"pip install dpbench{extra}"

"""A configuration: one solver, its call mode and its settings, from the plan to the page."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dpbench.bench.record.cell import Formulation, Units
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.record import LEVELS

COMMON_FORMULATION: Formulation = "condensed_box"
"""The formulation that solvers are compared in."""
CONFIGURATION_COLUMNS = ("solver", "route", "policy", "settings", "formulation", "units")
"""The columns of `runs.parquet` that name a configuration."""


@dataclass(frozen=True)
class Configuration:
    """A solver with call mode, settings, units and formulation, as results are compared by.

    `alias` has further names of the same settings, where settings have no effect.
    """

    solver: str
    route: Route
    policy: Policy
    settings: str = "default"
    units: Units = "scaled"
    formulation: Formulation = COMMON_FORMULATION
    alias: tuple[str, ...] = field(default=(), compare=False)

    @property
    def options(self) -> str:
        """Call of the solver, with unusual settings, as text such as `native warm, high`."""
        settings = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{settings}"

    @property
    def label(self) -> str:
        """Solver and options as text, such as `osqp (native warm, high, si, sparse)`."""
        return self.label_of(self.solver)

    def label_of(self, solver: str) -> str:
        """Return the label with another name of the solver, such as one with its version."""
        units = "" if self.units == "scaled" else f", {self.units}"
        formulated = self.formulation not in (COMMON_FORMULATION, "none")
        formulation = f", {self.formulation.replace('_', ' ')}" if formulated else ""
        return f"{solver} ({self.options}{units}{formulation})"

    @property
    def in_common_formulation(self) -> Configuration:
        """The configuration moved to the condensed formulation, in which results are compared."""
        return replace(self, formulation=COMMON_FORMULATION)


def settings_level(settings: str) -> tuple[int, str]:
    """Return a sort key of a settings name: default and tolerance presets first, in order."""
    known = settings in LEVELS
    level = LEVELS.index(settings) if known else len(LEVELS)
    return level, settings

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
    """solver × route × policy × settings × units × formulation.

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
        """Route, policy and, where they are not `default`, settings: `native warm, high`."""
        settings = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{settings}"

    @property
    def label(self) -> str:
        """Label among others: `osqp (native warm, high, si, sparse)`."""
        return self.label_of(self.solver)

    def label_of(self, solver: str) -> str:
        """Return the label with another name of the solver, such as one with its version."""
        units = "" if self.units == "scaled" else f", {self.units}"
        formulated = self.formulation not in (COMMON_FORMULATION, "none")
        formulation = f", {self.formulation.replace('_', ' ')}" if formulated else ""
        return f"{solver} ({self.options}{units}{formulation})"

    @property
    def in_common_formulation(self) -> Configuration:
        """The configuration in the common formulation of its problem (`Records.runs`)."""
        return replace(self, formulation=COMMON_FORMULATION)


def settings_level(settings: str) -> tuple[int, str]:
    """Return the sort key of a settings level, the most usual first."""
    known = settings in LEVELS
    level = LEVELS.index(settings) if known else len(LEVELS)
    return level, settings

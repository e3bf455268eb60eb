"""A configuration: one solver, its call mode and its settings, from the plan to the page."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dpbench.bench.record.cell import Formulation, Units
from dpbench.solvers.contract import Policy, Route, Settings
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml
from dpbench.solvers.record import LEVELS

COMMON_FORMULATION: Formulation = "condensed_box"
"""The formulation that solvers are compared in."""
CONFIGURATION_COLUMNS = (
    *("solver", "route", "policy", "settings", "options"),
    *("formulation", "units"),
)
"""The columns of `runs.parquet` that name a configuration."""


@dataclass(frozen=True)
class Configuration:
    """A solver with call mode, settings, units and formulation, as results are compared by.

    `options` of settings of one's own are JSON, "" with a preset; `alias` has further names of the
    same settings, where settings have no effect.
    """

    solver: str
    route: Route
    policy: Policy
    settings: str = "default"
    units: Units = "scaled"
    formulation: Formulation = COMMON_FORMULATION
    options: str = ""
    alias: tuple[str, ...] = field(default=(), compare=False)

    @property
    def solver_settings(self) -> Settings:
        """Settings to open the solver with: options of one's own, or the name of a preset."""
        return decode_options_from_json(self.options) or self.settings

    @property
    def options_text(self) -> str:
        """Options of settings of one's own, where their name does not show them; "" else."""
        text = format_options_as_toml(decode_options_from_json(self.options))
        return "" if text == self.settings else text

    @property
    def call_text(self) -> str:
        """Call of the solver, with unusual settings, as text such as `native warm, high`."""
        settings = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{settings}"

    @property
    def label(self) -> str:
        """Solver and options as text, such as `osqp (native warm, high, si, sparse)`."""
        return self.make_label_with_name(self.solver)

    def make_label_with_name(self, solver: str) -> str:
        """Return the label with another name of the solver, such as one with its version."""
        units = "" if self.units == "scaled" else f", {self.units}"
        formulated = self.formulation not in (COMMON_FORMULATION, "none")
        formulation = f", {self.formulation.replace('_', ' ')}" if formulated else ""
        return f"{solver} ({self.call_text}{units}{formulation})"

    @property
    def moved_to_common_formulation(self) -> Configuration:
        """The configuration moved to the condensed formulation, in which results are compared."""
        return replace(self, formulation=COMMON_FORMULATION)


def sort_key_of_settings(settings: str) -> tuple[int, str]:
    """Return a sort key of a settings name: default and tolerance presets first, in order."""
    known = settings in LEVELS
    level = LEVELS.index(settings) if known else len(LEVELS)
    return level, settings

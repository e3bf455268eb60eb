"""dpbench: which QP solver to trust inside the MPC of a dynamically positioned ship.

The names below are the public interface; each is imported when it is first used, so that
`import dpbench` costs nothing and a worker loads no library it does not measure.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dpbench.bench.campaign import run_campaign
    from dpbench.bench.run.exact_loop import record_sequence
    from dpbench.bench.sequences.sequence_file import load_sequence, save_sequence
    from dpbench.errors import DpbenchError, InputError
    from dpbench.mpc.condensed_qp import CondensedQP
    from dpbench.notebook.results import Results, load_results
    from dpbench.notebook.runs import Run, replay, run_closed_loop
    from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram, Refresh
    from dpbench.qp.referee.optimum import Optimum
    from dpbench.qp.referee.referee import certify
    from dpbench.qp.residuals import Residuals, residuals
    from dpbench.qp.solution import Solution, Status
    from dpbench.report.compare.comparison import Comparison, compare
    from dpbench.report.write import write_report
    from dpbench.scenario.scenario import Scenario, condense, load_scenario
    from dpbench.solvers.contract import Workspace
    from dpbench.solvers.open import open_workspace

_HOMES = {
    "Comparison": "report.compare.comparison",
    "CondensedQP": "mpc.condensed_qp",
    "DpbenchError": "errors",
    "InputError": "errors",
    "Optimum": "qp.referee.optimum",
    "QPSequence": "qp.program",
    "QPStep": "qp.program",
    "QuadraticProgram": "qp.program",
    "Refresh": "qp.program",
    "Residuals": "qp.residuals",
    "Results": "notebook.results",
    "Run": "notebook.runs",
    "Scenario": "scenario.scenario",
    "Solution": "qp.solution",
    "Status": "qp.solution",
    "Workspace": "solvers.contract",
    "certify": "qp.referee.referee",
    "compare": "report.compare.comparison",
    "condense": "scenario.scenario",
    "load_results": "notebook.results",
    "load_scenario": "scenario.scenario",
    "load_sequence": "bench.sequences.sequence_file",
    "open_workspace": "solvers.open",
    "record_sequence": "bench.run.exact_loop",
    "replay": "notebook.runs",
    "residuals": "qp.residuals",
    "run_campaign": "bench.campaign",
    "run_closed_loop": "notebook.runs",
    "save_sequence": "bench.sequences.sequence_file",
    "write_report": "report.write",
}

__all__ = [
    "Comparison",
    "CondensedQP",
    "DpbenchError",
    "InputError",
    "Optimum",
    "QPSequence",
    "QPStep",
    "QuadraticProgram",
    "Refresh",
    "Residuals",
    "Results",
    "Run",
    "Scenario",
    "Solution",
    "Status",
    "Workspace",
    "certify",
    "compare",
    "condense",
    "load_results",
    "load_scenario",
    "load_sequence",
    "open_workspace",
    "record_sequence",
    "replay",
    "residuals",
    "run_campaign",
    "run_closed_loop",
    "save_sequence",
    "write_report",
]


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'dpbench' has no attribute {name!r}")
    value = getattr(import_module(f"dpbench.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

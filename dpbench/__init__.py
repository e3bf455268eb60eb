"""dpbench: which QP solver to trust inside the MPC of a dynamically positioned ship.

The names below are the public interface; each is imported when it is first used, so that
`import dpbench` costs nothing and a worker loads no library it does not measure.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dpbench.bench.campaign import run_campaign as run_campaign
    from dpbench.bench.run.exact_loop import record_sequence as record_sequence
    from dpbench.bench.sequences.export import export_sequence as export_sequence
    from dpbench.bench.sequences.sequence_file import (
        load_sequence as load_sequence,
        save_sequence as save_sequence,
    )
    from dpbench.errors import (
        CertificateError as CertificateError,
        DpbenchError as DpbenchError,
        InputError as InputError,
        PolicyError as PolicyError,
        ResultsError as ResultsError,
        SettingsError as SettingsError,
        SolverUnavailableError as SolverUnavailableError,
        UnknownNameError as UnknownNameError,
    )
    from dpbench.mpc.condensed_qp import CondensedQP as CondensedQP
    from dpbench.notebook.names import (
        list_scenarios as list_scenarios,
        list_sequences as list_sequences,
        list_solvers as list_solvers,
        list_suites as list_suites,
    )
    from dpbench.notebook.results import Results as Results, load_results as load_results
    from dpbench.notebook.runs import (
        Run as Run,
        replay as replay,
        run_closed_loop as run_closed_loop,
    )
    from dpbench.notebook.stored_runs import add_runs as add_runs
    from dpbench.qp.program import (
        QPSequence as QPSequence,
        QPStep as QPStep,
        QuadraticProgram as QuadraticProgram,
        Refresh as Refresh,
        Units as Units,
    )
    from dpbench.qp.referee.optimum import Optimum as Optimum
    from dpbench.qp.referee.referee import certify as certify
    from dpbench.qp.residuals import Residuals as Residuals, residuals as residuals
    from dpbench.qp.solution import Solution as Solution, Status as Status
    from dpbench.report.compare.comparison import Comparison as Comparison, compare as compare
    from dpbench.report.write import write_report as write_report
    from dpbench.scenario.plants.contract import Plant as Plant, PlantError as PlantError
    from dpbench.scenario.plants.linear_mpc import LinearMPC as LinearMPC
    from dpbench.scenario.scenario import (
        Scenario as Scenario,
        condense as condense,
        load_scenario as load_scenario,
    )
    from dpbench.solvers.contract import Workspace as Workspace
    from dpbench.solvers.function import opener as opener
    from dpbench.solvers.open import open_workspace as open_workspace

_NAMES = {
    "bench.campaign": "run_campaign",
    "bench.run.exact_loop": "record_sequence",
    "bench.sequences.export": "export_sequence",
    "bench.sequences.sequence_file": "load_sequence save_sequence",
    "errors": "CertificateError DpbenchError InputError PolicyError ResultsError SettingsError "
    "SolverUnavailableError UnknownNameError",
    "mpc.condensed_qp": "CondensedQP",
    "notebook.names": "list_scenarios list_sequences list_solvers list_suites",
    "notebook.results": "Results load_results",
    "notebook.runs": "Run replay run_closed_loop",
    "notebook.stored_runs": "add_runs",
    "qp.program": "QPSequence QPStep QuadraticProgram Refresh Units",
    "qp.referee.optimum": "Optimum",
    "qp.referee.referee": "certify",
    "qp.residuals": "Residuals residuals",
    "qp.solution": "Solution Status",
    "report.compare.comparison": "Comparison compare",
    "report.write": "write_report",
    "scenario.plants.contract": "Plant PlantError",
    "scenario.plants.linear_mpc": "LinearMPC",
    "scenario.scenario": "Scenario condense load_scenario",
    "solvers.contract": "Workspace",
    "solvers.function": "opener",
    "solvers.open": "open_workspace",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'dpbench' has no attribute {name!r}")
    value = getattr(import_module(f"dpbench.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

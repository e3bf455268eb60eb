"""Names that the functions of the package take: of solvers, scenarios, suites and sequences."""

from dpbench.scenario.problem_files import SEQUENCES, problem_names
from dpbench.solvers.table import solver_names


def list_solvers() -> list[str]:
    """Return the names of all known solvers, installed or not.

    Examples
    --------
    >>> {"daqp", "osqp", "paper_active_set"} <= set(list_solvers())
    True
    """
    return list(solver_names())


def list_scenarios() -> list[str]:
    """Return the names of all scenarios of the package.

    Examples
    --------
    >>> list_scenarios()[:3]
    ['calm', 'extreme', 'mismatch']
    """
    return problem_names("scenarios")


def list_suites() -> list[str]:
    """Return the names of all suites of the package.

    Examples
    --------
    >>> "standard" in list_suites()
    True
    """
    return problem_names("suites")


def list_sequences() -> list[str]:
    """Return the names of all QP sequences of the package.

    Examples
    --------
    >>> "paper-30-5" in list_sequences()
    True
    """
    return problem_names(SEQUENCES)

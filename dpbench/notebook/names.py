"""Names that the functions of the package take: of solvers, scenarios, suites and sequences."""

from dpbench.display import make_html_table
from dpbench.errors import require_type
from dpbench.scenario.problem_files import SEQUENCES, list_shipped_problem_names
from dpbench.solvers.settings import list_options_by_route
from dpbench.solvers.table import (
    find_solver_availability,
    find_solver_record,
    list_all_solver_names,
)

_HEADS = ("solver", "version", "kind", "licence", "call modes")


class SolverNames(list[str]):
    """Names of solvers, shown as a table: version, kind of method, licence and call modes."""

    @staticmethod
    def options(name: str) -> dict[str, list[str]]:
        """Return the names of a solver's options by route; {} if it is not installed.

        Examples
        --------
        >>> "rho" in list_solvers().options("osqp")["native"]
        True
        """
        require_type("name", name, str, "the name of a solver")
        return list_options_by_route(name)

    def __repr__(self) -> str:
        rows = [_HEADS, *map(_describe_solver, self)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)

    def _repr_html_(self) -> str:
        """Return the table as HTML, which a notebook displays."""
        return make_html_table(_HEADS, map(_describe_solver, self))


def _describe_solver(name: str) -> tuple[str, ...]:
    """Describe a solver by a row of cells below `_HEADS`."""
    # Importing all libraries takes longer than all the rest.
    row, library = find_solver_record(name), find_solver_availability(name, imported=False)
    version = library.version if library.ok else "not installed"
    modes = "; ".join(f"{route}: {', '.join(p)}" for route, p in row.policies_by_route.items())
    return name, version, row.family, row.project.licence.value, modes


def list_solvers() -> SolverNames:
    """Return the names of all known solvers, installed or not, which are shown as a table.

    Examples
    --------
    >>> {"daqp", "osqp", "paper_active_set"} <= set(list_solvers())
    True
    """
    return SolverNames(list_all_solver_names())


def list_scenarios() -> list[str]:
    """Return the names of all scenarios of the package.

    Examples
    --------
    >>> list_scenarios()[:3]
    ['calm', 'extreme', 'mismatch']
    """
    return list_shipped_problem_names("scenarios")


def list_suites() -> list[str]:
    """Return the names of all suites of the package.

    Examples
    --------
    >>> "standard" in list_suites()
    True
    """
    return list_shipped_problem_names("suites")


def list_sequences() -> list[str]:
    """Return the names of all QP sequences of the package.

    Examples
    --------
    >>> "paper-30-5" in list_sequences()
    True
    """
    return list_shipped_problem_names(SEQUENCES)

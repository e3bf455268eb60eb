"""A plain function as a solver of policy `fresh`: the shortest plug-in."""

import inspect
from collections.abc import Callable, Mapping
from typing import Concatenate

from dpbench.errors import InputError, require_type, shorten_found
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status, copy_checked_answer
from dpbench.solvers.contract import (
    Options,
    Policy,
    Workspace,
    check_step,
    describe_exception_unless_interrupt,
    make_error_for_missing_setup,
)
from dpbench.solvers.own_settings import convert_numbers_of_numpy
from dpbench.solvers.plugins import refuse_bad_or_taken_name
from dpbench.solvers.table import BUILT_IN

Solve = Callable[Concatenate[QuadraticProgram, ...], Solution]


class FunctionWorkspace(Workspace):
    """A solver made of a Python function that solves one QP; its exceptions become ERROR."""

    def __init__(self, name: str, policy: Policy, solve: Solve, options: Options) -> None:
        super().__init__(name, "native", policy)
        self.setup_every_step = True
        self._function, self._options = solve, dict(options)
        self.requested_settings = convert_numbers_of_numpy(options)
        self._qp: QuadraticProgram | None = None
        self._solution: Solution | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Store a copy of the QP for the user's function."""
        self._qp, self._solution = qp.copy(), None

    def update(self, step: QPStep) -> None:
        """Store a copy of the QP with the arrays that this step changes."""
        if self._qp is None:
            raise make_error_for_missing_setup("update")
        check_step(step, self._qp.n, self._qp.m)
        self.matrix_updates += step.refresh is not Refresh.VECTORS
        self.setup(self._qp.at(step))

    def solve(self) -> None:
        """Call the user's function on the QP; store its answer or its exception."""
        assert self._qp is not None, "setup comes first"
        try:
            answer: Solution | None = self._function(self._qp, **self._options)
            if answer is None:
                # `_solution` is None before the call, so an answer None is replaced.
                answer = copy_checked_answer(answer, self._qp.n, self._qp.m)
            self._solution = answer
        except MemoryError:
            raise
        except Exception as error:
            self._solution = self._make_solution_of_status_error(
                describe_exception_unless_interrupt(error)
            )

    def read(self) -> Solution:
        """Return a copy of the answer that the user's function gave."""
        answer = self._solution
        if answer is None:
            return self._make_solution_of_status_error("read before solve")
        try:
            z, y, y_box = answer.z.copy(), answer.y.copy(), answer.y_box.copy()
        except AttributeError:
            # No solution, or not of arrays.
            assert self._qp is not None, "setup comes first"
            return copy_checked_answer(answer, self._qp.n, self._qp.m)
        return Solution(
            answer.status, z, y, y_box, answer.iterations, answer.reported_ns, answer.detail
        )

    def _make_solution_of_status_error(self, detail: str) -> Solution:
        """Return an answer without numbers, of status ERROR, with an explanation."""
        assert self._qp is not None, "setup comes first"
        return Solution.without_point(self._qp.n, self._qp.m, Status.ERROR, detail)


def opener(name: str, solve: Solve) -> Callable[[Policy, Options], Workspace]:
    """Return a plug-in solver's `open(policy, options)`, from a function that solves one QP.

    The only policy is "fresh"; options are keyword arguments of the function. `open` raises
    InputError for others.

    Raises
    ------
    InputError : for what is no function, or a name with a path or of a solver of dpbench.

    Examples
    --------
    >>> import numpy as np
    >>> from dpbench import Solution, Status, replay
    >>> def minimise_without_limits(qp, scale=1.0):
    ...     z = -scale * np.linalg.solve(qp.P, qp.q)
    ...     return Solution(Status.SOLVED, z, np.full(qp.m, np.nan), np.full(qp.n, np.nan))
    >>> workspace = opener("newton", minimise_without_limits)("fresh", {"scale": 0.9})
    >>> replay("paper-30-5", workspace, repeats=1).label
    'newton (native, fresh, scale=0.9)'
    """
    require_type("name", name, str, "the name of the solver")
    refuse_bad_or_taken_name("opener", "name", name, BUILT_IN)
    where = f"solver {name}"
    if not callable(solve):
        raise InputError(where, "", shorten_found(solve), "a function of one QP")

    def open_function(policy: Policy, options: Options) -> Workspace:
        if policy != "fresh":
            raise InputError(where, "policy", repr(policy), "'fresh', as the solver is a function")
        allowed = "a mapping from names of options to values, or {}"
        require_type("options", options, Mapping, allowed)
        try:
            inspect.signature(solve).bind(None, **options)
        except TypeError:
            known = [*inspect.signature(solve).parameters][1:]
            allowed = ", ".join(known) or "none, as the function has none"
            raise InputError(where, "options", shorten_found(dict(options)), allowed) from None
        except ValueError:
            pass  # A function in C may have no signature.
        return FunctionWorkspace(name, policy, solve, options)

    # Read when a plug-in is loaded.
    names = _list_option_names(solve)
    open_function.option_names = names  # type: ignore[attr-defined] # mypy knows no own attributes
    return open_function


def _list_option_names(solve: Callable[..., object]) -> list[str] | None:
    """Return the names of a function's options; None where it has no signature or takes any."""
    try:
        parameters = [*inspect.signature(solve).parameters.values()][1:]
    except (TypeError, ValueError):
        return None  # It is not callable, or written in C.
    if any(one.kind is one.VAR_KEYWORD for one in parameters):
        return None
    named = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    return [one.name for one in parameters if one.kind in named]

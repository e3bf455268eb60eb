"""A custom linear MPC, for a plant that need not be a ship.

Its QPs are built as those of the ship's controller: from the incremental model of x⁺ = A x + B u,
y = C x, with limits of u and of its change, condensed.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from dpbench.arrays import Matrix, Vector
from dpbench.errors import (
    InputError,
    ShapeError,
    require_integer_at_least,
    require_type,
    shorten_found,
)
from dpbench.files.regular_files import is_plain_file_name
from dpbench.mpc.condense import ControlProblem, Terminal
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import StateSpace, augment_to_incremental_model, discretise_zero_order_hold
from dpbench.scenario.controllers.controller import FIXED_MODEL, Controller, MetricGroup
from dpbench.scenario.problem_files import ScenarioDocuments

_ROUNDING = float(np.finfo(np.float64).eps)
"""Eigenvalues within this share of the largest, times the size, are zero."""


class LinearController(Controller):
    """Controller of a plant that is no ship: u acts on it as it is."""

    metric_groups: ClassVar[tuple[MetricGroup, ...]] = ()

    def convert_commands_to_ship_force(self, u: Matrix) -> Matrix:
        """Return the inputs (..., n_u) unchanged: they act on the plant."""
        return u

    def select_applied_commands(self, tau: Matrix, thrust: Matrix) -> Matrix:
        """Return the applied inputs tau (K, n_u), which are the commands."""
        return tau


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearMPC:
    """Model predictive control of a plant by a linear model x⁺ = A x + B u, y = C x.

    The plan minimises ½ Σ (y − y_d)ᵀ Q (y − y_d) + ½ Σ Δuᵀ R Δu. The model is used for changes of
    x and u alone, so it may be linearised at any point; x, u and y are absolute values.

    Parameters
    ----------
    name : of the problem in tables and file names.
    A, B, C : (n_x, n_x), (n_x, n_u), (n_y, n_x), in discrete time.
    sample_s, steps : length [s] and number of the samples of a run.
    prediction_horizon, control_horizon : N_p and N_c, samples and planned moves.
    output_weight, increment_weight : Q and R, positive semidefinite; a vector is the diagonal.
    u_min, u_max, du_max : (n_u,) limits of u, and of its change in one sample; all finite.
    reference : (n_y,) or, over time, (K, n_y), whose last row is kept; the plan sees none ahead.
    u_start : (n_u,) input before the first sample; zero by default.
    terminal : "riccati" adds the cost beyond the horizon.
    inputs, outputs : names of u and y in `Run.signals`, with their units.

    Raises
    ------
    InputError : for impossible horizons, limits, weights, shapes or names, or if the QPs are not
        positive definite.

    Examples
    --------
    >>> mpc = LinearMPC.from_continuous(
    ...     name="integrator", A=[[0.0]], B=[[1.0]], C=[[1.0]], sample_s=0.1, steps=20,
    ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], increment_weight=[0.1],
    ...     u_min=[-1.0], u_max=[1.0], du_max=[0.5], reference=[1.0],
    ... )  # fmt: skip
    >>> mpc
    <LinearMPC integrator: 1 state, 1 input, 1 output, 10/3, 20 steps of 0.1 s>
    """

    name: str
    A: ArrayLike
    B: ArrayLike
    C: ArrayLike
    sample_s: float
    steps: int
    prediction_horizon: int
    control_horizon: int
    output_weight: ArrayLike
    increment_weight: ArrayLike
    u_min: ArrayLike
    u_max: ArrayLike
    du_max: ArrayLike
    reference: ArrayLike
    u_start: ArrayLike | None = None
    terminal: Terminal = "none"
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    preview: ClassVar[bool] = False
    model: StateSpace = field(init=False)
    first_input: Vector = field(init=False)
    controller: LinearController = field(init=False)

    def __post_init__(self) -> None:
        require_type("LinearMPC: name", self.name, str, "a name without a path")
        if not is_plain_file_name(self.name):
            raise InputError("LinearMPC", "name", repr(self.name), "a name without a path")
        require_integer_at_least(f"{self.name}: steps", self.steps, 1)
        for key in ("prediction_horizon", "control_horizon"):
            require_type(f"{self.name}: {key}", getattr(self, key), Integral, "a whole number")
        _require_sample_s(self.name, self.sample_s)
        A, B, C = (_to_array(self.name, key, getattr(self, key), 2) for key in "ABC")
        model = StateSpace(A, B, C)
        object.__setattr__(self, "model", model)
        start = np.zeros(model.n_u) if self.u_start is None else self.u_start
        object.__setattr__(self, "first_input", self._vector("u_start", start, model.n_u))
        for key, count, letter in (("inputs", model.n_u, "u"), ("outputs", model.n_y, "y")):
            given = getattr(self, key)
            if isinstance(given, str):
                allowed = f"a sequence of names, such as ({given!r},)"
                raise InputError(self.name, key, repr(given), allowed)
            require_type(f"{self.name}: {key}", given, Iterable, "a sequence of names")
            names = tuple(given) or tuple(f"{letter}{i}" for i in range(count))
            if len(names) != count or len(set(names)) != count:
                allowed = f"{count} different names" if count > 1 else "1 name"
                found = f"{len(names)} {'name' if len(names) == 1 else 'names'}, {names}"
                raise InputError(self.name, key, found, allowed)
            object.__setattr__(self, key, names)
        self.build_reference_table(1)
        object.__setattr__(self, "controller", self._build_controller())

    @classmethod
    def from_continuous(
        cls, *, A: ArrayLike, B: ArrayLike, C: ArrayLike, sample_s: float, **others: Any
    ) -> "LinearMPC":
        """Return the problem of a continuous model ẋ = A x + B u, discretised under held inputs.

        Examples
        --------
        >>> mpc = LinearMPC.from_continuous(
        ...     name="integrator", A=[[0.0]], B=[[1.0]], C=[[1.0]], sample_s=0.1, steps=20,
        ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], u_min=[-1.0],
        ...     increment_weight=[0.1], u_max=[1.0], du_max=[0.5], reference=[1.0])  # fmt: skip
        >>> mpc.B
        array([[0.1]])
        """
        name = str(others.get("name", "LinearMPC"))
        _require_sample_s(name, sample_s)
        matrices = (_to_array(name, key, m, 2) for key, m in zip("ABC", (A, B, C), strict=True))
        model = discretise_zero_order_hold(StateSpace(*matrices), sample_s)
        return cls(A=model.A, B=model.B, C=model.C, sample_s=sample_s, **others)

    def __repr__(self) -> str:
        model = self.model
        counts = [(model.n_x, "state"), (model.n_u, "input"), (model.n_y, "output")]
        sizes = ", ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in counts)
        horizons = f"{self.prediction_horizon}/{self.control_horizon}"
        return (
            f"<LinearMPC {self.name}: {sizes}, {horizons}, "
            f"{self.steps} steps of {self.sample_s:.4g} s>"
        )

    @property
    def files(self) -> ScenarioDocuments:
        """Documents of the problem in results: its name alone, as it is no ship's scenario.

        Examples
        --------
        >>> mpc = LinearMPC(
        ...     name="integrator", A=[[1.0]], B=[[0.1]], C=[[1.0]], sample_s=0.1, steps=20,
        ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], u_min=[-1.0],
        ...     increment_weight=[0.1], u_max=[1.0], du_max=[0.5], reference=[1.0])  # fmt: skip
        >>> mpc.files
        {'name': 'integrator'}
        """
        return {"name": self.name}

    @property
    def problem(self) -> ControlProblem:
        """Control problem of the MPC: incremental model, horizons, weights and limits.

        Examples
        --------
        >>> mpc = LinearMPC(
        ...     name="integrator", A=[[1.0]], B=[[0.1]], C=[[1.0]], sample_s=0.1, steps=20,
        ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], u_min=[-1.0],
        ...     increment_weight=[0.1], u_max=[1.0], du_max=[0.5], reference=[1.0])  # fmt: skip
        >>> mpc.problem.N_p, mpc.problem.N_c
        (10, 3)
        """
        return self.controller.problem

    def _build_controller(self) -> LinearController:
        """Return the controller that plans by condensed QPs; InputError for impossible limits."""
        name, n_u, n_y = self.name, self.model.n_u, self.model.n_y
        low, high, most = (
            self._vector(key, getattr(self, key), n_u) for key in ("u_min", "u_max", "du_max")
        )
        for key, is_wrong, allowed in (
            ("u_max", (high <= low).any(), "above u_min in every entry"),
            ("du_max", (most <= 0.0).any(), "above 0 in every entry"),
        ):
            if is_wrong:
                raise InputError(name, key, shorten_found(getattr(self, key)), allowed)
        if not 1 <= self.control_horizon <= self.prediction_horizon:
            allowed = f"1 to prediction_horizon ({self.prediction_horizon})"
            raise InputError(name, "control_horizon", self.control_horizon, allowed)
        problem = ControlProblem(
            augment_to_incremental_model(self.model),
            self.prediction_horizon,
            self.control_horizon,
            _to_weight(name, "output_weight", self.output_weight, n_y),
            _to_weight(name, "increment_weight", self.increment_weight, n_u),
            low,
            high,
            most,
            self.terminal,
        )
        eigenvalues = np.linalg.eigvalsh(CondensedQP(problem).P)
        if not eigenvalues[0] > _ROUNDING * len(eigenvalues) * eigenvalues[-1]:
            found = f"a Hessian whose smallest eigenvalue is {eigenvalues[0]:.1g}"
            allowed = "weights that make it positive definite, such as weights above 0"
            raise InputError(name, "increment_weight", found, allowed)
        return LinearController(
            tuning=name,
            problem=problem,
            psi0_rad=0.0,
            linearisation=FIXED_MODEL,
            amplitude="reachable",
            outputs=None,
            changes=(),
        )

    def build_reference_table(self, samples: int) -> Matrix:
        """Return the reference of the outputs at each sample (samples, n_y).

        Examples
        --------
        >>> mpc = LinearMPC(
        ...     name="integrator", A=[[1.0]], B=[[0.1]], C=[[1.0]], sample_s=0.1, steps=20,
        ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], u_min=[-1.0],
        ...     increment_weight=[0.1], u_max=[1.0], du_max=[0.5], reference=[1.0])  # fmt: skip
        >>> mpc.build_reference_table(2)
        array([[1.],
               [1.]])
        """
        given = np.atleast_2d(np.asarray(self.reference, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] != self.model.n_y or not np.isfinite(given).all():
            n_y = self.model.n_y
            expected = f"finite numbers of shape ({n_y},), or (K, {n_y}) for K samples"
            raise ShapeError.from_shapes(self.name, "reference", given.shape, expected)
        table: Matrix = given[np.minimum(np.arange(samples), len(given) - 1)]
        return table

    def truncate(self, steps: int) -> "LinearMPC":
        """Return a copy of the problem cut to its first `steps` samples.

        Examples
        --------
        >>> mpc = LinearMPC(
        ...     name="integrator", A=[[1.0]], B=[[0.1]], C=[[1.0]], sample_s=0.1, steps=20,
        ...     prediction_horizon=10, control_horizon=3, output_weight=[1.0], u_min=[-1.0],
        ...     increment_weight=[0.1], u_max=[1.0], du_max=[0.5], reference=[1.0])  # fmt: skip
        >>> mpc.truncate(5).steps
        5
        """
        steps = require_integer_at_least(f"{self.name}: steps", steps, 1)
        return replace(self, steps=min(steps, self.steps))

    def _vector(self, key: str, values: ArrayLike, size: int) -> Vector:
        """Return values as a vector of a size; ShapeError, naming the key, for another."""
        vector = _to_array(self.name, key, values, 1)
        if vector.shape != (size,):
            raise ShapeError.from_shapes(self.name, key, vector.shape, f"shape ({size},)")
        return vector


def _require_sample_s(name: str, sample_s: float) -> None:
    """Raise TypeError or InputError for a sample time that is not a number above 0."""
    allowed = "a number above 0"
    require_type(f"{name}: sample_s", sample_s, Real, allowed)
    if not (np.isfinite(sample_s) and sample_s > 0.0):
        raise InputError(name, "sample_s", sample_s, allowed)


def _to_array(name: str, key: str, values: ArrayLike, dimensions: int) -> Matrix:
    """Return values as an array of finite numbers; InputError, naming the key, for others."""
    array = _to_numbers(name, key, values)
    if array.ndim != dimensions:
        expected = "a vector, such as [1.0, 2.0]", "a matrix, such as [[1.0], [2.0]]"
        raise ShapeError.from_shapes(name, key, array.shape, expected[dimensions - 1])
    return array


def _to_numbers(name: str, key: str, values: ArrayLike) -> Matrix:
    """Return values as an array of any shape; InputError, naming the key, unless all are finite."""
    try:
        array: Matrix = np.array(values, dtype=np.float64, ndmin=1)
    except (TypeError, ValueError) as error:
        raise InputError(name, key, shorten_found(values), "finite numbers") from error
    if len(wrong := array[~np.isfinite(array)]):
        raise InputError(name, key, f"the value {wrong[0]}", "finite numbers")
    return array


def _to_weight(name: str, key: str, values: ArrayLike, size: int) -> Matrix:
    """Return a weight as a matrix (size, size), from its diagonal or the whole of it."""
    weight = _to_numbers(name, key, values)
    weight = np.diag(weight) if weight.ndim == 1 else weight
    if weight.shape != (size, size):
        raise ShapeError.from_shapes(
            name, key, weight.shape, f"shape ({size},) or ({size}, {size})"
        )
    if (weight != weight.T).any() or not _is_semidefinite(weight):
        allowed = "weights of at least 0, or a symmetric positive semidefinite matrix"
        raise InputError(name, key, shorten_found(values), allowed)
    return weight


def _is_semidefinite(matrix: Matrix) -> bool:
    """Return whether no eigenvalue of a symmetric matrix is below 0 by more than rounding."""
    eigenvalues = np.linalg.eigvalsh(matrix)
    return bool(eigenvalues[0] >= -_ROUNDING * len(matrix) * abs(eigenvalues[-1]))

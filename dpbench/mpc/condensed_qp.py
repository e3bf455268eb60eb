"""`CondensedQP`: the builder of the QP of every step of the DP controller.

The constructor may be slow; `emit` is one product Z [θ; 1] into fresh memory and three views of it.
"""

from typing import Literal, TypedDict

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.errors import InputError, ShapeError, require_type
from dpbench.mpc.condense import (
    CondensedMatrices,
    ControlProblem,
    UnitSystem,
    build_affine_map,
    build_rows_of_summed_increments,
    condense_mpc_matrices,
    scale_amplitude_limit_rows,
)
from dpbench.mpc.kernels import write_limits_reachable_at_rate
from dpbench.mpc.model import HORIZONTAL
from dpbench.mpc.soft_limits import (
    ConstraintBlock,
    OutputBounds,
    Penalty,
    assemble_qp_of_cost_and_blocks,
    build_amplitude_constraint_block,
    build_output_constraint_blocks,
    choose_bounded_prediction_steps,
)
from dpbench.mpc.thruster_rows import LimitRampDown, Limits
from dpbench.qp.program import QPStep, QuadraticProgram, Units, describe_qp_size

# Policy of amplitude limits for plan row i: `reachable`, as far as the rate can follow them;
# `hard`, the limits, though no plan may satisfy them; `soft`, with a slack at an exact penalty.
Amplitude = Literal["reachable", "hard", "soft"]


class CondensedOptions(TypedDict, total=False):
    """Options of a condensed MPC QP: units, amplitude-limit policy, output bounds, penalties."""

    units: UnitSystem
    amplitude: Amplitude
    outputs: OutputBounds | None
    penalty: Penalty | None


class CondensedQP:
    """Builder of the condensed QP of each control step, for one MPC problem.

    Parameters
    ----------
    problem : model, horizons, weights and limits in SI units.
    units : "scaled" (z = ΔU/Δu_max) or "si" (z = ΔU in N, N, N·m).
    amplitude : policy of the amplitude limits.
    outputs : bounds on predicted position and speed, softened; None for none, as in the paper.
    penalty : of the slacks; None for `Penalty.choose_exact_penalty`.

    Attributes
    ----------
    P (n, n), A (m, n), lb, ub (n,) : constant; n = N_c·block, m = N_c rows of a move.
    block : variables per move; n_u, the moves, come first, then slacks.
    Z (n + 2m, n_θ + 1) : the affine map [q; l; u] = Z [x; y_ref; u_prev; 1].
    matrices : E, F, Φ of the paper in SI units.
    scale : how z and the rows relate to the scaled ones (`Units`).

    Examples
    --------
    >>> from dpbench import condense
    >>> condense("paper")
    <CondensedQP: 15 variables, 15 rows, scaled>
    """

    def __init__(
        self,
        problem: ControlProblem,
        *,
        units: UnitSystem = "scaled",
        amplitude: Amplitude = "reachable",
        outputs: OutputBounds | None = None,
        penalty: Penalty | None = None,
    ) -> None:
        require_type("CondensedQP: problem", problem, ControlProblem, "a ControlProblem")
        bounds = "OutputBounds, or None for none"
        require_type("CondensedQP: outputs", outputs, OutputBounds | None, bounds)
        chosen = "a Penalty, or None to choose it"
        require_type("CondensedQP: penalty", penalty, Penalty | None, chosen)
        if units not in ("scaled", "si"):
            raise InputError("CondensedQP", "units", repr(units), '"scaled" or "si"')
        if amplitude not in ("reachable", "hard", "soft"):
            allowed = '"reachable", "hard" or "soft"'
            raise InputError("CondensedQP", "amplitude", repr(amplitude), allowed)
        self.control, self.units = problem, units
        self.amplitude, self.outputs, self.penalty = amplitude, outputs, penalty
        self._matrices: CondensedMatrices = condense_mpc_matrices(problem)
        self._du: Vector = problem.du_max if units == "scaled" else np.ones(problem.model.n_u)
        self._build_qp_with_hard_limits()
        extra = self._list_extra_constraint_blocks()
        if amplitude == "soft" or outputs is not None or extra:
            self._build_qp_with_constraint_blocks(extra)
        self._prepare_buffers_of_emit()

    def __repr__(self) -> str:
        return f"<CondensedQP: {describe_qp_size(self.n, self.m)}, {self.units}>"

    @property
    def matrices(self) -> CondensedMatrices:
        """Condensed MPC matrices in SI units: Hessian E, free response F, prediction matrix Φ.

        Examples
        --------
        >>> from dpbench import condense
        >>> matrices = condense("paper").matrices
        >>> matrices.E.shape, matrices.F.shape
        ((15, 15), (90, 9))
        """
        return self._matrices

    def _build_qp_with_hard_limits(self) -> None:
        """Build P, A and bounds of the QP whose limits are all hard, over the plan of moves."""
        problem, N_c = self.control, self.control.N_c
        self.block = problem.model.n_u
        self.n, self.m = N_c * self.block, N_c * len(problem.G)
        # Joining copies takes a fraction of the time of numpy.tile.
        du_max, one = np.concatenate([problem.du_max] * N_c), np.ones(self.n)
        if self.units == "scaled":
            own, du, rows = one, du_max, np.ones(self.m)
        else:
            own, du, rows = du_max, one, np.concatenate([problem.row_max] * N_c)
        self.scale = Units(own, rows)
        self._du_plan = du
        self.P: Matrix = du[:, np.newaxis] * du
        self.P *= self._matrices.E
        self.A: Matrix = build_rows_of_summed_increments(
            N_c, scale_amplitude_limit_rows(problem, self.units)
        )
        self.ub: Vector = own.copy()
        self.lb: Vector = -own
        self.Z: Matrix = build_affine_map(problem, self._matrices, self.units)

    def _list_extra_constraint_blocks(self) -> list[ConstraintBlock]:
        """Return constraint blocks that a subclass adds to each move; none here."""
        return []

    def _build_qp_with_constraint_blocks(self, extra: list[ConstraintBlock]) -> None:
        """Build P, A and bounds of the QP with blocks of further or soft limits."""
        problem, matrices = self.control, self._matrices
        du = np.tile(problem.du_max, problem.N_c)
        P, Z = matrices.E * np.outer(du, du), build_affine_map(problem, matrices, "scaled")
        penalty = Penalty.choose_exact_penalty(problem, P) if self.penalty is None else self.penalty
        soft = self.amplitude == "soft"
        blocks = [build_amplitude_constraint_block(problem, Z, penalty.amplitude if soft else None)]
        if self.outputs is not None:
            blocks += build_output_constraint_blocks(
                problem, matrices, self.outputs, penalty.outputs
            )
        blocks += extra
        built = assemble_qp_of_cost_and_blocks(
            P, Z[: len(P)], problem.du_max, blocks, penalty.curvature
        )
        self.block, self.penalty = built.block, penalty
        self.m, self.n = built.A.shape
        own, self.scale = built, Units(np.ones(self.n), np.ones(self.m))
        if self.units == "si":
            own, self.scale = built.convert_to_si_units(), built.si
        self.P, self.A, self.lb, self.ub, self.Z = own.P, own.A, own.lb, own.ub, own.Z

    def _prepare_buffers_of_emit(self) -> None:
        """Allocate the parameter vector and compute the array slices that build each step's QP."""
        n_u, at = self.control.model.n_u, self.control.model.theta
        theta = np.ones(at.size)
        # One tuple of locals instead of eight look-ups, and the bound method, which costs half of
        # numpy.dot(Z, theta): emitting is measured against the bare product.
        parts = theta[at.x], theta[at.y_ref], theta[at.u_prev]
        self._parts = (*parts, theta, self.Z.dot, self.n, self.n + self.m)
        problem, N_c, r = self.control, self.control.N_c, len(self.control.G)
        first = r if self.amplitude == "soft" else 0
        self._shape, self._row_shape = (N_c, self.block), (N_c, self.m // N_c)
        self._moves = slice(None), slice(0, n_u)
        self._upper = slice(None), slice(0, r)
        self._lower = slice(None), slice(first, first + r)
        self._row_unit = self.scale.row[:r]
        self._ramp_down: LimitRampDown | None = None
        if problem.thrusters is not None and self.amplitude == "reachable":
            rates = problem.du_max, problem.row_max
            self._ramp_down = LimitRampDown(problem.thrusters, *rates, N_c, factor=self._row_unit)

    def emit(
        self, x: Vector, y_ref: Vector, u_prev: Vector, *, limits: Limits | None = None
    ) -> QPStep:
        """Return the QP data q, l and u of one step (eq. 20-24), in newly allocated memory.

        The values are not checked, as the call is timed: NaN or None give a QP with NaN.

        Parameters
        ----------
        x : (n_x,) augmented state [Δν, Δη, y], SI; heading unwrapped.
        y_ref : (n_y,) reference, or (N_p, n_y) for preview; heading within π of y's.
        u_prev : (n_u,) force applied in the last sample [N, N, N·m], or those of thrusters [N].
        limits : those in force from now on instead of the vessel's, (r,) each. Under the policy
            `reachable` plan row i gets max(u_max, u_prev − iΔu_max) and so on, because a limit that
            drops below u_prev by more than one rate step leaves no feasible point. A thruster whose
            limits drop may retreat straight to zero (`LimitRampDown`).

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> condense("paper").emit(x=np.zeros(9), y_ref=np.ones(3), u_prev=np.zeros(3))
        <QPStep: 15 variables, 15 rows, vectors>
        """
        x_part, y_part, u_part, theta, product, n, cut = self._parts
        try:
            x_part[...] = x
            u_part[...] = u_prev
            preview = y_ref.ndim != 1
            y_part[...] = y_ref[0] if preview else y_ref
        except (AttributeError, TypeError, ValueError):
            # Only now, as this call is timed.
            self._refuse_other_shapes(x, y_ref, u_prev)
            raise
        out = product(theta)
        step = QPStep(out[:n], out[n:cut], out[cut:])
        if preview:
            self._add_reference_preview_to_step(step, y_ref)
        if limits is not None:
            self._write_amplitude_limits_into_step(step, u_prev, limits)
        return step

    def _refuse_other_shapes(self, x: Vector, y_ref: Vector, u_prev: Vector) -> None:
        """Raise ShapeError for an argument of `emit` of another shape, TypeError for a list."""
        x_part, y_part, u_part, *_ = self._parts
        preview = (self.control.N_p, *y_part.shape)
        for name, given, shapes in (
            ("x", x, [x_part.shape]),
            ("y_ref", y_ref, [y_part.shape, preview]),
            ("u_prev", u_prev, [u_part.shape]),
        ):
            if np.shape(given) not in shapes:
                expected = " or ".join(f"shape {shape}" for shape in shapes)
                raise ShapeError.from_shapes("emit", name, np.shape(given), expected)
            require_type(f"emit: {name}", given, np.ndarray, "an array")

    def _add_reference_preview_to_step(self, step: QPStep, y_ref: Matrix) -> None:
        """Add the effect of a reference (N_p, n_y) that varies along the horizon to q and u."""
        change = y_ref - y_ref[0]
        slope = self._du_plan * (self._build_reference_to_gradient_map() @ change.reshape(-1))
        moves = step.q.reshape(self._shape)[self._moves]
        moves += slope.reshape(moves.shape)
        bounds = self.outputs
        if bounds is not None and bounds.radius_m is not None:
            # The circle moves with the reference as it does with the one that is held.
            first = self._lower[1].stop
            circle = slice(first, first + bounds.sides)
            upper_map = self.Z[self.n + self.m :].reshape(*self._row_shape, -1)
            of_position = upper_map[0, circle, self.control.model.theta.y_ref][:, HORIZONTAL]
            bounded = choose_bounded_prediction_steps(self.control.N_p, self.control.N_c) - 1
            moved = change[bounded, HORIZONTAL] @ of_position.T
            step.u.reshape(self._row_shape)[:, circle] += moved

    def _build_reference_to_gradient_map(self) -> Matrix:
        """Return the map (N_c·n_u, N_p·n_y) from the reference to the QP gradient, in SI units."""
        return self._matrices.F_y

    def _write_amplitude_limits_into_step(
        self, step: QPStep, u_prev: Vector, limits: Limits
    ) -> None:
        """Write the limits of forces at this step into its vectors l and u."""
        problem, unit = self.control, self._row_unit
        if self._ramp_down is not None:
            self._ramp_down.write_limits(u_prev, limits, step.l, step.u)
        elif self.amplitude == "reachable":
            of_rows = limits.low, limits.high, problem.row_max, unit
            write_limits_reachable_at_rate(u_prev, *of_rows, step.l, step.u, problem.N_c)
        else:
            before = u_prev if problem.thrusters is None else problem.G @ u_prev
            low, high = ((side - before) / problem.row_max for side in (limits.low, limits.high))
            step.l.reshape(self._row_shape)[self._lower] = low * unit
            step.u.reshape(self._row_shape)[self._upper] = high * unit

    def repeat_flags_for_each_move(self, of_row: Flags) -> Flags:
        """Return flags (m,) of all rows: those (r,) of force limits at each move, else False.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> builder = condense("paper")
        >>> int(builder.repeat_flags_for_each_move(np.array([True, False, False])).sum())
        5
        """
        spread = np.zeros(self.m, dtype=np.bool_)
        for side in (self._upper, self._lower):
            spread.reshape(self._row_shape)[side] = of_row
        return spread

    def problem(self, step: QPStep) -> QuadraticProgram:
        """Return the complete QP of one step, constant matrices included.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> builder = condense("paper")
        >>> builder.problem(builder.emit(np.zeros(9), np.ones(3), np.zeros(3)))
        <QuadraticProgram: 15 variables, 15 rows>
        """
        P = self.P if step.P is None else step.P
        A = self.A if step.A is None else step.A
        moves = len(self._du) if self.block > len(self._du) else 0
        limits = step.l, step.u, self.lb, self.ub
        return QuadraticProgram(P, step.q, A, *limits, block=self.block, moves=moves)

    def moves(self, z: Vector) -> Matrix:
        """Return the control increments ΔU (N_c, n_u) of a solution z, in N, N, N·m.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> condense("paper").moves(np.ones(15))[0]
        array([ 32736.,  11008., 475200.])
        """
        return z.reshape(self._shape)[self._moves] * self._du

    def convert_increments_to_variables(self, delta_u: Matrix) -> Vector:
        """Convert control increments (N_c, n_u) [N, N, N·m] to QP variables z, slacks at zero.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> builder = condense("paper")
        >>> z = builder.convert_increments_to_variables(builder.moves(np.ones(15)))
        >>> bool(np.allclose(z, 1.0))
        True
        """
        z = np.zeros(self.n)
        z.reshape(self._shape)[self._moves] = delta_u / self._du
        return z

    def constant_part_of_cost(
        self, x: Vector, y_ref: Vector, u_prev: Vector | None = None
    ) -> float:
        """Return the constant part J0 of the MPC cost, which no control increment changes.

        Examples
        --------
        >>> import numpy as np
        >>> from dpbench import condense
        >>> condense("paper").constant_part_of_cost(x=np.zeros(9), y_ref=np.ones(3))
        1530.0
        """
        problem = self.control
        y_d = np.tile(y_ref, problem.N_p) if y_ref.ndim == 1 else y_ref.reshape(-1)
        error = (y_d - self.matrices.F @ x).reshape(problem.N_p, -1)
        cost = 0.5 * float(np.einsum("ki,ij,kj->", error, problem.Q, error))
        if problem.W is not None and u_prev is not None:
            cost += 0.5 * problem.N_c * float(u_prev @ problem.W @ u_prev)
        end = self.matrices.end
        return (
            cost
            if end is None
            else cost + end.cost_at_zero_increments(x, y_d[-problem.model.n_y :])
        )

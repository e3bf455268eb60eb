"""`RelinearisedQP`: the condensed QP re-linearised at the measured heading, step by step.

Linearising at ψ turns the model by T = diag(I, R, R) (`relinearise_model_at_turned_heading`), so
with R = R(ψ − ψ0)

    h_t ↦ R h_t,    F_t ↦ R F_t Tᵀ,    E ↦ Σ hᵀ (RᵀQR) h + R̄,    F_x ↦ Σ hᵀ (RᵀQR) F_t Tᵀ

(eq. 15-24): every entry of P, A and Z is a trigonometric polynomial of degree 2 in ψ. Condensing at
five headings 72° apart therefore gives them at all headings, to rounding, for a few multiply-adds a
step. For a Q that weighs north and east alike, RᵀQR = Q and P is the same at every heading:
re-linearising then changes q alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar, Unpack

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.errors import InputError
from dpbench.mpc.condense import CondensedMatrices, ControlProblem, condense_mpc_matrices
from dpbench.mpc.condensed_qp import CondensedOptions, CondensedQP
from dpbench.mpc.model import HEADING
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QPStep

_TURNS = 2.0 * np.pi * np.arange(5) / 5  # Five samples determine a polynomial of degree 2
_CHECKED_TURN = 1.0  # A heading apart from all samples, where the polynomials are verified
_NOISE = 1e-13  # Smaller changes, relative to the largest entry of a column, are rounding
_DEGREE_TWO = 1e-9  # Tolerance at the checked heading, relative likewise

Wave = TypeVar("Wave", float, Vector)


@dataclass(frozen=True, eq=False)
class HeadingSeries:
    """Matrix-valued trigonometric polynomial of degree 2 in the change of heading δ.

        entry(δ) = c_0 + c_1 cos δ + c_2 sin δ + c_3 cos 2δ + c_4 sin 2δ

    `varying` : flat indices of the entries that change; `constant` : c_0; `terms` : (number of the
    basis function − 1, coefficients) of the others that are not zero.
    """

    varying: Indices
    constant: Vector
    terms: list[tuple[int, Vector]]

    @classmethod
    def fit_to_samples(cls, samples: Sequence[Matrix]) -> "HeadingSeries":
        """Fit a trigonometric polynomial to matrices sampled at five equally spaced headings."""
        stack = np.array([np.where(np.isfinite(sample), sample, 0.0) for sample in samples])
        size = np.broadcast_to(_NOISE * np.abs(stack).max(axis=(0, 1)), stack.shape[1:]).reshape(-1)
        stack = stack.reshape(len(_TURNS), -1)
        varying = np.flatnonzero(np.ptp(stack, axis=0) > size)
        values, size = stack[:, varying], size[varying]
        waves = 0.4 * np.array(_compute_heading_harmonics(np.cos(_TURNS), np.sin(_TURNS))) @ values
        terms = [(k, wave) for k, wave in enumerate(waves) if (np.abs(wave) > size).any()]
        return cls(varying, values.mean(axis=0), terms)

    def write_matrix_at_turn(self, turn_rad: float, out: Matrix) -> None:
        """Evaluate the polynomial at a heading change [rad]; write varying entries to `out`."""
        waves = _compute_heading_harmonics(math.cos(turn_rad), math.sin(turn_rad))
        # Entry by entry alike, so that a symmetric matrix stays so to the last bit.
        values = self.constant.copy()
        for k, coefficients in self.terms:
            values += waves[k] * coefficients
        out.reshape(-1)[self.varying] = values


def _compute_heading_harmonics(c: Wave, s: Wave) -> tuple[Wave, Wave, Wave, Wave]:
    """Return cos δ, sin δ, cos 2δ, sin 2δ from c = cos δ and s = sin δ."""
    return c, s, c * c - s * s, 2.0 * c * s


class RelinearisedQP(CondensedQP):
    """Builder of the condensed QP, re-linearised at the measured heading of each step.

    problem, units, amplitude, outputs, penalty : as for `CondensedQP`.
    psi0_rad : heading at which the model of `problem` is linearised.
    threshold_rad : least distance of the heading from the last time; 0 re-linearises each step.
    always : bring P with every re-linearised step, like a controller that condenses anew; False,
        only if entries of P depend on the heading.
    P, A, Z, matrices : those of the last step; A and P in arrays that later steps leave alone.
    heading_rad : where they are linearised.
    InputError : when the QP is no polynomial of degree 2 in the heading, as with a Riccati terminal
        cost under a Q that weighs north and east unlike.
    """

    def __init__(
        self,
        problem: ControlProblem,
        *,
        psi0_rad: float,
        threshold_rad: float = 0.0,
        always: bool = True,
        **form: Unpack[CondensedOptions],
    ) -> None:
        super().__init__(problem, **form)
        if not threshold_rad >= 0.0:
            raise InputError("RelinearisedQP", "threshold_rad", threshold_rad, "0 or more")
        self.psi0_rad = self.heading_rad = psi0_rad
        self.threshold_rad = threshold_rad
        self._condensed_at = psi0_rad
        *samples, check = [
            self._condense_at_turned_heading(turn) for turn in (*_TURNS, _CHECKED_TURN)
        ]
        self._sampled = [sample.matrices for sample in samples]
        parts = {name: [getattr(sample, name) for sample in samples] for name in ("P", "A", "Z")}
        self._series = {
            name: HeadingSeries.fit_to_samples(of_turns) for name, of_turns in parts.items()
        }
        self._require_series_equal_to(check)
        self._brings_P = always or len(self._series["P"].varying) > 0
        self._brings_A = len(self._series["A"].varying) > 0

    def _condense_at_turned_heading(self, turn_rad: float) -> CondensedQP:
        """Condense the problem of a ship turned by an angle [rad]."""
        form = CondensedOptions(units=self.units, amplitude=self.amplitude, outputs=self.outputs)
        return CondensedQP(
            self.control.relinearise_at_turned_heading(turn_rad),
            **(form | {"penalty": self.penalty}),
        )

    def _require_series_equal_to(self, check: CondensedQP) -> None:
        """Raise InputError if polynomials in heading miss the QP condensed at another heading."""
        for name, series in self._series.items():
            condensed, interpolated = getattr(check, name), getattr(self, name).copy()
            series.write_matrix_at_turn(_CHECKED_TURN, interpolated)
            finite = np.isfinite(condensed)
            expected = np.where(finite, condensed, 0.0)
            error = np.abs(np.where(finite, interpolated, 0.0) - expected)
            if (error > _DEGREE_TWO * np.abs(expected).max(axis=0)).any():
                found = "values that do not rotate with the heading"
                allowed = "a terminal cost and weights that rotate with the ship"
                raise InputError("RelinearisedQP", name, found, allowed)

    @property
    def matrices(self) -> CondensedMatrices:
        """Condensed matrices E, F, Φ at the last heading, SI; recomputed after it changes."""
        if self._condensed_at != self.heading_rad:
            turn = self.heading_rad - self.psi0_rad
            self._matrices = condense_mpc_matrices(self.control.relinearise_at_turned_heading(turn))
            self._condensed_at = self.heading_rad
        return self._matrices

    @cached_property
    def _reference_map_series(self) -> HeadingSeries:
        """Polynomial in the heading that gives the map from the reference to the QP gradient."""
        return HeadingSeries.fit_to_samples([matrices.F_y for matrices in self._sampled])

    def _build_reference_to_gradient_map(self) -> Matrix:
        """Return the map from the reference to q at the present heading."""
        F_y = self._sampled[0].F_y.copy()
        self._reference_map_series.write_matrix_at_turn(self.heading_rad - self.psi0_rad, F_y)
        return F_y

    def update_matrices_to_heading(self, psi_rad: float) -> None:
        """Update the QP matrices P, A and Z to the ship model linearised at heading `psi_rad`."""
        self.heading_rad = float(psi_rad)
        turn = self.heading_rad - self.psi0_rad
        if len(self._series["P"].varying):
            self.P = self.P.copy()
            self._series["P"].write_matrix_at_turn(turn, self.P)
        if self._brings_A:
            self.A = self.A.copy()
            self._series["A"].write_matrix_at_turn(turn, self.A)
        # In place: `emit` holds the product with this very array.
        self._series["Z"].write_matrix_at_turn(turn, self.Z)

    def emit(
        self, x: Vector, y_ref: Vector, u_prev: Vector, *, limits: Limits | None = None
    ) -> QPStep:
        """Return the QP of one step, re-linearised if the heading has changed by the threshold.

        A re-linearised step brings P (see `always`), and A where its entries depend on the heading:
        those of output bounds do, scaled amplitude rows do not.
        """
        psi_rad = x[HEADING]
        if not abs(psi_rad - self.heading_rad) >= self.threshold_rad:
            return super().emit(x, y_ref, u_prev, limits=limits)
        self.update_matrices_to_heading(psi_rad)
        step = super().emit(x, y_ref, u_prev, limits=limits)
        if self._brings_P:
            step.P = self.P
        if self._brings_A:
            step.A = self.A
        return step

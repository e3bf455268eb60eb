"""What a controller linearises: its model once or at each step, or rows of azimuths that turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, Unpack

from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.condensed_qp import CondensedQP, Form
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP


class Linearisation(Protocol):
    """Makes the condensed QPs of a problem, whose model is linearised at one heading.

    Attributes
    ----------
    why_no_sparse_form : why its QPs have no formulation with the states kept; "" where they have.
    """

    why_no_sparse_form: ClassVar[str]

    def condense(self, problem: ControlProblem, **form: Unpack[Form]) -> CondensedQP:
        """Return the builder of the QPs."""


@dataclass(frozen=True)
class FixedModel:
    """One model for the whole run."""

    why_no_sparse_form: ClassVar[str] = ""

    def condense(self, problem: ControlProblem, **form: Unpack[Form]) -> CondensedQP:
        """Return the builder of the QPs."""
        return CondensedQP(problem, **form)


@dataclass(frozen=True)
class RelinearisedModel:
    """A model at each measured heading, from that of the problem at psi0_rad on."""

    psi0_rad: float

    why_no_sparse_form: ClassVar[str] = (
        "sparse: the model is linearised anew at each step, and its stages with it"
    )

    def condense(self, problem: ControlProblem, **form: Unpack[Form]) -> CondensedQP:
        """Return the builder of the QPs."""
        return RelinearisedQP(problem, psi0_rad=self.psi0_rad, **form)


@dataclass(frozen=True, eq=False)
class TurningRows:
    """One model, and at each step the rows of azimuths that turn at a limited rate."""

    turning: AzimuthTurning

    why_no_sparse_form: ClassVar[str] = (
        "sparse: the directions of azimuths are other ones at each step, and so are rows"
    )

    def condense(self, problem: ControlProblem, **form: Unpack[Form]) -> CondensedQP:
        """Return the builder of the QPs."""
        return TurningQP(problem, self.turning, **form)

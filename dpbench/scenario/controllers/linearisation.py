"""What a controller linearises: its model once or at each step, or rows of azimuths that turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP


@dataclass(frozen=True)
class Linearisation:
    """How a problem, whose model is linearised at one heading, becomes condensed QPs.

    condense : makes the builder of a problem, with the arguments of `CondensedQP`.
    why_no_sparse_form : why its QPs have no formulation with the states kept; "" where they have.
    """

    condense: Callable[..., CondensedQP]
    why_no_sparse_form: str = ""


FIXED_MODEL = Linearisation(CondensedQP)
"""One model for the whole run."""


def relinearised_model(psi0_rad: float) -> Linearisation:
    """Return a model at each measured heading, from that of the problem at psi0_rad on."""
    why = "sparse: the model is linearised anew at each step, and its stages with it"
    return Linearisation(partial(RelinearisedQP, psi0_rad=psi0_rad), why)


def turning_rows(turning: AzimuthTurning) -> Linearisation:
    """Return one model, and at each step the rows of azimuths that turn at a limited rate."""
    why = "sparse: the directions of azimuths are other ones at each step, and so are rows"
    return Linearisation(partial(TurningQP, turning=turning), why)

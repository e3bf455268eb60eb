"""The forces that a ship's thrusters make together, at full thrust without losses."""

import math
from functools import partial

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.capability.choices import find_least_use_and_pieces
from dpbench.bench.capability.utilisation import Utilisation
from dpbench.ship.capability.shapes import Piece, split_force_set_into_convex_pieces
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import ThrusterSet

_CHORD_RAD = math.radians(1.0)


class ThrusterReach:
    """Solver of the share of full thrust that a force on the ship takes of all thrusters together.

    A limit of one axis by itself may need a force in another: a ship with tunnels in the bow alone
    makes no force sideways without turning.
    """

    def __init__(self, thrusters: ThrusterSet) -> None:
        self._utilisation = Utilisation(thrusters)
        self._shares = np.ones(len(thrusters.thrusters))
        self._list_piece_choices = tuple(
            tuple(split_force_set_into_convex_pieces(thruster.sector_rad, [], [], [], _CHORD_RAD))
            if thruster.kind == "azimuth"
            else (Piece(),)
            for thruster in thrusters.thrusters
        )

    def find_least_thrust_share(self, force: Vector) -> float:
        """Return the least share of full thrust that makes a force (3,) [N, N, N·m]; inf if none.

        The thrusters make it where the share is at most 1.
        """
        relax = partial(
            self._utilisation.relax_to_convex_hulls, -force, self._shares, lost=frozenset()
        )
        return find_least_use_and_pieces(relax, self._list_piece_choices)[0]

    def find_least_and_largest_pure_forces(self) -> tuple[Vector, Vector]:
        """Return the least and largest force (3,) of each axis with none in the other two."""
        axes = np.eye(AXES)
        low, high = (
            [1.0 / self.find_least_thrust_share(s * axis) for axis in axes] for s in (-1.0, 1.0)
        )
        return -np.array(low), np.array(high)

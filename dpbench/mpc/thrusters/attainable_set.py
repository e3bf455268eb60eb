"""Forces that a ship's thrusters can make together, as limits of a controller of forces.

    {T_e f : each f_i in its polygon}  =  {τ : −h(−n) ≤ n·τ ≤ h(n) for every facet's normal n}

The set is a sum of segments and polygons, one a thruster, each flat in the space of surge, sway and
yaw. Every facet of such a sum holds two edges of its parts that are not parallel, so the cross
products of all pairs of edges are all normals, and h(n) = Σ max n·T_e v over the corners v of the
parts (Ziegler 1995, Lectures on Polytopes, section 7.2). A box of three limits, one an axis, allows
far more than the thrusters make at once, or excludes some of it. With thrusters lost the parts are
fewer, but their edges are among the same: the normals stay and h falls.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import Limits, ThrusterRows
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import Thruster, ThrusterSet

_PARALLEL = 1e-9  # Smaller cross products, and distances of normals, are one direction


@dataclass(frozen=True, eq=False)
class AttainableSet:
    """Polytope of the forces (surge, sway, yaw) that all thrusters attain together.

    normals : (r, 3) rows n [1, 1, 1/m], one for a facet and the one across.
    corners : of each thruster's part (v_i, 3) [N, N, N·m].
    """

    normals: Matrix
    corners: tuple[Matrix, ...]

    def facet_limits_after_loss(self, lost: Collection[int]) -> Limits:
        """Return the facets' limits after a loss; all force is lost where the set is empty."""
        low, high = np.zeros(len(self.normals)), np.zeros(len(self.normals))
        for i, corners in enumerate(self.corners):
            if i not in lost:
                along = self.normals @ corners.T
                low += along.min(axis=1)
                high += along.max(axis=1)
        return Limits(low, high, np.array([(low == high).any()]))

    def to_linear_limit_rows(self) -> ThrusterRows:
        """Return the polytope of attainable forces as linear limits on force and moment."""
        low, high, _ = self.facet_limits_after_loss(())
        one_group = (np.zeros(size, dtype=np.intp) for size in (len(low), AXES))
        return ThrusterRows(self.normals, low, high, *one_group)


def build_attainable_force_polytope(thrusters: ThrusterSet, sides: int) -> AttainableSet:
    """Return the polytope of attainable forces, circles as polygons; InputError for a sector."""
    corners = (
        (t, _list_force_corners_of_thruster(t, sides, thrusters.where)) for t in thrusters.thrusters
    )
    parts = [along @ thruster.configuration_columns.T for thruster, along in corners]
    # In metres of arm, moments weigh as forces do, and edges can be compared.
    arm = np.array([1.0, 1.0, 1.0 / thrusters.longest_arm_m])
    edges = np.vstack([_list_unit_edge_directions(part * arm) for part in parts])
    pairs = np.triu_indices(len(edges), 1)
    crossed = np.cross(edges[pairs[0]], edges[pairs[1]])
    size = np.linalg.norm(crossed, axis=1)
    normals = _remove_parallel_directions(
        crossed[size > _PARALLEL] / size[size > _PARALLEL, np.newaxis]
    )
    return AttainableSet(np.ascontiguousarray(normals * arm), tuple(parts))


def _list_force_corners_of_thruster(thruster: Thruster, sides: int, where: str) -> Matrix:
    """Return the corner forces (v, components) of one thruster's limits, in order."""
    if thruster.sector_rad is not None:
        found = f"a sector for thruster {thruster.name!r}"
        allowed = 'no sector_deg where limits = "attainable"'
        raise InputError(where, "thrusters.sector_deg", found, allowed)
    if thruster.kind != "azimuth":
        return np.array([[-thruster.astern * thruster.thrust_N], [thruster.thrust_N]])
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return thruster.thrust_N * np.column_stack((np.cos(angle), np.sin(angle)))


def _list_unit_edge_directions(corners: Matrix) -> Matrix:
    """Return the unit directions (e, 3) of a polygon's edges, parallel ones once."""
    along = np.roll(corners, -1, axis=0) - corners
    return _remove_parallel_directions(along / np.linalg.norm(along, axis=1, keepdims=True))


def _remove_parallel_directions(directions: Matrix) -> Matrix:
    """Return those of the unit vectors (k, 3) not parallel to another; signs may turn."""
    first = np.argmax(np.abs(directions) > 1e-6, axis=1)
    sign = np.sign(directions[np.arange(len(directions)), first])
    turned = directions * sign[:, np.newaxis]
    _, kept = np.unique(np.round(turned / _PARALLEL / 10.0), axis=0, return_index=True)
    distinct = turned[np.sort(kept)]
    close = np.abs(distinct @ distinct.T) > 1.0 - _PARALLEL
    return np.asarray(distinct[np.argmax(close, axis=1) == np.arange(len(distinct))])

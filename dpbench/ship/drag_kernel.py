"""Compiled evaluation of the drag of a hull (`drag`)."""

import numpy as np

from dpbench.kernel_cache import njit
from dpbench.ship.layout import R, U, V

_FADING, _ALONG, _ACROSS, _CENTRE, _HALF_LENGTH = range(5)  # Entries of `HullDrag.to_kernel_array`


@njit(cache=True, error_model="numpy", fastmath=False)
def write_drag_force(u, v, r, D, hull, out):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the drag F (3,) at a velocity through the water to out."""
    speed = np.sqrt(u * u + v * v)
    root = np.exp(-0.5 * speed * hull[_FADING])
    u_left, v_left = root * u, root * v
    middle, edge = v + hull[_CENTRE] * r, hull[_HALF_LENGTH] * r
    force, moment = _mean_cross_flow_force_and_moment(middle, edge)
    across = hull[_ACROSS] * force
    out[U] = root * (D[U, U] * u_left + D[U, V] * v_left + D[U, R] * r)
    out[V] = root * (D[V, U] * u_left + D[V, V] * v_left + D[V, R] * r)
    out[R] = D[R, U] * u_left + D[R, V] * v_left + D[R, R] * r
    out[U] += hull[_ALONG] * speed * u
    out[V] += across
    out[R] += hull[_CENTRE] * across + hull[_ACROSS] * hull[_HALF_LENGTH] * moment


@njit(cache=True, error_model="numpy", fastmath=False)
def _mean_cross_flow_force_and_moment(middle, edge):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Return the means of w|w| and t w|w| over −1 ≤ t ≤ 1, of w = middle + edge t."""
    aft, fore = middle - edge, middle + edge
    if aft * fore >= 0.0:
        size = abs(middle)
        return middle * size + edge * edge / 3.0 * np.sign(middle), 2.0 / 3.0 * size * edge
    aft_cubed, fore_cubed = abs(aft) ** 3, abs(fore) ** 3
    grown = fore_cubed - aft_cubed
    turned = 0.25 * (fore_cubed * fore - aft_cubed * aft) - middle / 3.0 * grown
    return grown / (6.0 * edge), turned / (2.0 * edge * edge)

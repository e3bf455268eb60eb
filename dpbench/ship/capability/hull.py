"""A hull as level 1 of DNV-ST-0111 asks for it (its table A-2)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CapabilityHull:
    """A ship-shaped hull at its summer draught, on an even keel.

    Places are ahead and to starboard of the middle of L_pp.

    Parameters
    ----------
    length_m, breadth_m, draught_m : L_pp, B at the waterline, T.
    submerged_length_m, submerged_x_m : L_os from the foremost to the aftmost point under water, and
        the place of its middle.
    bow_angle_rad : half the angle at which the waterline meets ahead.
    aft_fullness : C_WL,aft, area of the waterline behind the middle over B·L_pp/2.
    frontal_m2, lateral_m2, lateral_x_m : areas above the water from ahead and from abeam, and the
        centre of the latter.
    submerged_m2, current_x_m : area under water from abeam, and its centre.
    skegs : (x, y) [m] of the aftmost point of each.
    assumed : what of these the file does not say, by its keys.
    """

    length_m: float
    breadth_m: float
    draught_m: float
    submerged_length_m: float
    submerged_x_m: float
    bow_angle_rad: float
    aft_fullness: float
    frontal_m2: float
    lateral_m2: float
    lateral_x_m: float
    submerged_m2: float
    current_x_m: float
    skegs: tuple[tuple[float, float], ...] = ()
    assumed: tuple[str, ...] = ()

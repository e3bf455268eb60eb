"""Thrust losses by level 1 of DNV-ST-0111 (2021), 3.9 and 3.11.

    T_effective = T_nominal · β_misc · β_vent · β_dead(α) · β_skeg(α)

β_misc = 0.9. The screw draws air in waves (3.9.4):

    β_vent = Φ(2 · 2ξ/D − 1.5 σ),   ξ depth of the shaft,  D diameter
    σ = ¼ (A Hs min(T0, 1) + max(√(T_nominal/D³)/15.2 − 1, 0)),   T0 = 0.64 √L_pp / Tz
    A = 0.85 · (1 + 0.38 min(γ', π − γ')/π) · (1 + 0.4 min(x, 0)/L_pp)

An azimuth may not send its race onto a working thruster (3.11.3), and loses thrust where it hits a
dead one (3.11.4) or a skeg (3.11.5); α is where it pushes to, clockwise from ahead.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from statistics import NormalDist

from dpbench.ship.capability.loads import CapabilityHull, Condition, mirror_angle_to_one_side
from dpbench.ship.thrusters import Thruster, ThrusterSet

MISCELLANEOUS = 0.9  # β_misc
FLUSHING_DIAMETERS = 15.0
"""Distance in diameters below which flushing a working thruster is forbidden."""
TURN = 2.0 * math.pi


def compute_thrust_share_when_vented(
    thruster: Thruster, hull: CapabilityHull, condition: Condition, from_rad: float
) -> float:
    """Return the share of thrust left when waves let the propeller draw air (β_vent)."""
    screw = thruster.screw
    if screw is None or screw.height_m is None:
        return 1.0
    turned = mirror_angle_to_one_side(from_rad)
    abeam = 1.0 + 0.38 * min(turned, math.pi - turned) / math.pi
    aft = 1.0 + 0.4 * min(thruster.x_m, 0.0) / hull.length_m
    period = min(0.64 * math.sqrt(hull.length_m) / condition.zero_crossing_s, 1.0)
    loading = math.sqrt(thruster.thrust_N / screw.diameter_m**3) / 15.2
    motion = 0.85 * abeam * aft * condition.hs_m * period
    sigma = 0.25 * (motion + max(loading - 1.0, 0.0))
    depth = hull.draught_m - screw.height_m
    return NormalDist().cdf(4.0 * depth / screw.diameter_m - 1.5 * sigma)


@dataclass(frozen=True)
class Loss:
    """Share of an azimuth's thrust left in a range of directions [rad], least at `worst`."""

    start: float
    worst: float
    end: float
    share: Callable[[float], float]

    def thrust_share_in_direction(self, direction: float) -> float:
        """Return the share of thrust left in a direction [rad]; 1 outside the range of loss."""
        inside = self.start + (direction - self.start) % TURN
        return self.share(inside) if inside < self.end else 1.0


def find_forbidden_thrust_directions(
    thruster: Thruster, working: Sequence[Thruster]
) -> list[tuple[float, float]]:
    """Return directions [rad] in which an azimuth's propeller race would hit a working thruster."""
    screw = thruster.screw
    zones = []
    for other in working:
        if screw is not None and _is_within_reach_of_race(thruster, other):
            distance = math.hypot(thruster.x_m - other.x_m, thruster.y_m - other.y_m)
            half = math.atan(0.1 + screw.diameter_m / distance)
            centre = _direction_hitting_other_thruster(thruster, other)
            zones.append((centre - half, centre + half))
    return zones


def list_thruster_cautions(thrusters: ThrusterSet) -> list[str]:
    """Return sentences on rudders that do not count, and on barred zones that leave the race."""
    rudders = thrusters.caution_on_rudders
    return [*([rudders] if rudders else []), *list_zone_cautions(thrusters)]


def describe_unused_turning_rates(thrusters: ThrusterSet) -> str:
    """Return a sentence on turning rates of azimuths that no controller limits; "" without any."""
    names = [t.name for t in thrusters.thrusters if t.turning_radps is not None]
    if not names:
        return ""
    return (
        f"turning_degps of {', '.join(names)} is not used: neither the controller nor the "
        "simulated thruster limits turning. A controller that commands thrusters limits it with "
        "azimuth_turning = true in [controller.thrusters]."
    )


def list_zone_cautions(thrusters: ThrusterSet) -> list[str]:
    """Return sentences on zones that bar the push towards a thruster and leave the race to it."""
    cautions = []
    for thruster in thrusters.thrusters:
        hit = [
            other.name
            for other in thrusters.thrusters
            if _is_within_reach_of_race(thruster, other)
            and thruster.may_push(to := _direction_hitting_other_thruster(thruster, other))
            and not thruster.may_push(to + math.pi)
        ]
        if hit and thruster.sector_rad is not None:
            start, end = (round(math.degrees(edge) + 180.0, 2) for edge in thruster.sector_rad)
            cautions.append(
                f"CAUTION: barred directions are those of the push. {thruster.name} may not push "
                f"towards {' or '.join(hit)}, but may send its race there. To bar the race, set "
                f"barred_deg = [{end % 360.0:g}, {start % 360.0:g}]."
            )
    return [*cautions, *_list_zones_kept_after_loss(thrusters)]


def _list_zones_kept_after_loss(thrusters: ThrusterSet) -> list[str]:
    """Return sentences on zones that bar the race to a thruster which is lost alone."""
    alone = [
        (one, other)
        for one, other in permutations(thrusters.thrusters, 2)
        if not one.barred_protects and (one.group or one.name) != (other.group or other.name)
    ]
    return [
        f"The barred zone of `{one.name}` stays in force after the loss of `{other.name}`. If it "
        "only protects that thruster, add barred_protects."
        for one, other in alone
        if (_is_within_reach_of_race(one, other) or _is_azimuth_beside(one, other))
        and not one.may_push(_direction_hitting_other_thruster(one, other))
    ]


def _is_azimuth_beside(thruster: Thruster, other: Thruster) -> bool:
    """Return whether two azimuths may reach each other for lack of a known propeller."""
    return thruster.screw is None and thruster.kind == other.kind == "azimuth"


def caution_on_wash(thrusters: ThrusterSet) -> list[str]:
    """Return a sentence on azimuths whose wash controllers may send at each other; none without.

    The capability plot bars such directions of azimuths with a known propeller only.
    """
    pairs = [
        (one, other)
        for one, other in combinations(thrusters.thrusters, 2)
        if _may_hit_azimuth(one, other) or _may_hit_azimuth(other, one)
    ]
    if not pairs:
        return []
    apart = "; ".join(
        f"{a.name} and {b.name}, {math.hypot(a.x_m - b.x_m, a.y_m - b.y_m):.3g} m apart"
        for a, b in pairs
    )
    is_barred = all(thruster.screw is not None for pair in pairs for thruster in pair)
    plot = (
        "the capability plot bars the directions concerned"
        if is_barred
        else "nor does the capability plot"
    )
    return [
        f"CAUTION: closed loops do not model the wash of one azimuth on another ({apart}); {plot}. "
        "For closed loops, set barred_deg in the vessel file, or the columns barred_from_deg and "
        "barred_to_deg in the CSV file. A barred zone leaves the controller at most half a turn, "
        "on one side of it, which may not hold the ship after a loss."
    ]


def _may_hit_azimuth(thruster: Thruster, other: Thruster) -> bool:
    """Return whether an azimuth's race may hit another one in the directions of controllers.

    Without a known propeller every other azimuth is within reach.
    """
    if thruster.kind != "azimuth" or other.kind != "azimuth":
        return False
    planned = replace(thruster, sector_rad=thruster.convex_sector_rad, controller_sector_rad=None)
    is_near = thruster.screw is None or _is_within_reach_of_race(thruster, other)
    return is_near and planned.may_push(_direction_hitting_other_thruster(thruster, other))


def _is_within_reach_of_race(thruster: Thruster, other: Thruster) -> bool:
    """Return whether an azimuth's race hits another propeller that lies in its direction."""
    if thruster.kind != "azimuth" or thruster.screw is None or other.kind == "tunnel":
        return False
    distance = math.hypot(thruster.x_m - other.x_m, thruster.y_m - other.y_m)
    return 0.0 < distance < FLUSHING_DIAMETERS * thruster.screw.diameter_m


def list_losses_at_dead_thrusters(thruster: Thruster, dead: Sequence[Thruster]) -> list[Loss]:
    """Return the losses of an azimuth that hits a dead thruster: straight lines from β to 1."""
    screw = thruster.screw
    if thruster.kind != "azimuth" or screw is None:
        return []
    reach, spread = (4.0, 0.35) if screw.propeller == "nozzle" else (8.0, 0.6)
    losses = []
    for other in dead:
        distance = math.hypot(thruster.x_m - other.x_m, thruster.y_m - other.y_m)
        diameters = distance / screw.diameter_m
        if other.kind == "tunnel" or not 0.0 < diameters < reach:
            continue
        half = math.atan(spread / diameters)
        beta = 1.0 - 1.0 / (0.02 * diameters**2 + 0.25 * diameters + 1.2)
        losses.append(
            _make_loss_of_one_dead_thruster(
                _direction_hitting_other_thruster(thruster, other), half, beta
            )
        )
    return losses


def _direction_hitting_other_thruster(thruster: Thruster, other: Thruster) -> float:
    """Return the direction [rad] of thrust that sends a thruster's race onto another thruster."""
    return math.atan2(thruster.y_m - other.y_m, thruster.x_m - other.x_m)


def _make_loss_of_one_dead_thruster(centre: float, half: float, beta: float) -> Loss:
    """Return a thrust loss by a dead thruster: share `beta` left at the centre, 1 at the edges."""

    def share(direction: float) -> float:
        off = abs(direction - centre)
        return beta * math.sin(half) / (math.sin(half - off) + beta * math.sin(off))

    return Loss(centre - half, centre, centre + half, share)


def list_losses_at_skegs(thruster: Thruster, hull: CapabilityHull) -> list[Loss]:
    """Return the thrust losses of an azimuth whose propeller race hits a skeg.

    Tables 3-7 and 3-8 are mirror images, so they are one in the angle towards the thruster's side.
    """
    screw = thruster.screw
    if thruster.kind != "azimuth" or screw is None:
        return []
    if screw.height_m is not None and screw.height_m <= 0.0:
        return []
    reach = 8.0 if screw.propeller == "nozzle" else 15.0
    losses = []
    for x_m, y_m in hull.skegs:
        ahead, aside = x_m - thruster.x_m, abs(y_m - thruster.y_m)
        distance = math.hypot(ahead, aside) if ahead > 0.0 else aside
        if aside > 0.0 and distance < reach * screw.diameter_m:
            jet = math.atan(0.6 * screw.diameter_m / distance)
            losses.append(_make_loss_of_one_skeg(ahead, aside, jet, thruster.y_m < y_m))
    return losses


def _make_loss_of_one_skeg(ahead: float, aside: float, jet: float, to_port: bool) -> Loss:
    """Return an azimuth's thrust loss, by direction, to a skeg `ahead` and `aside` [m] of it."""
    flush = 0.5 * math.pi + math.atan(ahead / aside)
    worst = min(max(flush + jet, 0.5 * math.pi), math.pi)
    start, end = max(flush - jet, 0.0), min(worst + 4.0 * jet, math.pi)
    least = 2.0 * worst / math.pi - 1.0

    def outboard(angle: float) -> float:
        if angle <= worst:
            return 1.0 - (1.0 - least) * (angle - start) / (worst - start)
        return least + (1.0 - least) * (angle - worst) / (end - worst)

    if to_port:
        return Loss(TURN - end, TURN - worst, TURN - start, lambda angle: outboard(TURN - angle))
    return Loss(start, worst, end, outboard)

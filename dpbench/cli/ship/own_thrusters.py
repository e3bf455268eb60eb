"""`dpbench init --thrusters`: the thrusters of one's own ship, and the sea that they hold."""

import argparse
import math
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dpbench.bench.capability.frontier import (
    FROM_DEG,
    INTACT,
    Capability,
    CapabilityPlot,
    WindLimit,
    compute_capability,
)
from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.cli.ship.capability import (
    caution_on_rudders,
    format_notation,
    save_rose_figure,
)
from dpbench.cli.terminal import WIDTH, ProgressBar
from dpbench.errors import InputError, SituationError
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.report.formats import floor_to_tenth, format_wind_held, join_with_and
from dpbench.scenario import own_ship as scaling
from dpbench.scenario.own_thrusters import (
    ASSUMED,
    Berth,
    complete_thruster_values,
    describe_assumed_values,
    list_assumed_values,
    read_rows_of_thruster_table,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.scenario.tables.scenario_file import ControllerTable
from dpbench.scenario.tables.vessel_file import ThrusterTable
from dpbench.ship.thrusters import Thruster, ThrusterSet, format_sector
from dpbench.ship.vessel import Vessel

WHERE = "init"
FORCES = ("thrust", "sway-thrust", "yaw-moment")
TO_WEIGHT = (1e-4, 0.5)
"""Least and largest thrust of all thrusters over the ship's weight; beyond it a unit is wrong."""
MOST_LOSSES = 3
"""Failure groups whose loss is simulated, each in a scenario of its own."""
MOST_FACETS = 150
"""Facets of an attainable set, each a row of the QP at every sample of the control horizon."""
SIDES_DEG = (scaling.FROM_DEG, 360.0 - scaling.FROM_DEG)
"""Starboard and port of the bow, from where the sea of a new ship may come."""
ASKED = ("kind", "x_m", "y_m", "power_kW", "thrust_kN", "group")
HINTS = {
    "kind": "azimuth, tunnel or main; empty to finish",
    "x_m": "ahead of midships",
    "y_m": "to starboard; empty: 0",
    "power_kW": "empty: enter thrust_kN instead",
    "thrust_kN": "",
    "group": "switchboard; empty: fails alone",
}


@dataclass(frozen=True, eq=False)
class OwnThrusters:
    """Thrusters of the user's ship, as tables of its file and in SI units, and rows as given."""

    where: str
    rows: list[dict[str, str]]
    tables: tuple[ThrusterTable, ...]
    thrusters: ThrusterSet
    half_turns: tuple[str, ...] = ()
    """Lines on each azimuth whose sector is too wide for controllers: half turns tried."""

    @property
    def assumed(self) -> list[str]:
        """Sentences on the values that the rows leave out."""
        return describe_assumed_values(self.rows, self.tables)

    @property
    def assumed_values(self) -> str:
        """Values that the rows leave out, by quantity; "" without any."""
        values = list_assumed_values(self.rows, self.tables)
        return "; ".join(f"{quantity} {text}" for quantity, text in values.items())

    @property
    def tables_with_assumed(self) -> list[tuple[ThrusterTable, list[str]]]:
        """Each thruster's table, and the keys whose value its row leaves out."""
        return [
            (table, [key for key in ASSUMED if key not in row])
            for table, row in zip(self.tables, self.rows, strict=True)
        ]

    def compute_thrust_limits(self) -> scaling.ThrustLimits:
        """Return the thrusters' largest forces, each axis by itself."""
        _, most = self.thrusters.least_and_largest_force_by_axis()
        return scaling.ThrustLimits(*most.tolist())

    def make_fitted_vessel(self, vessel: Vessel) -> Vessel:
        """Return a vessel with these thrusters and the limits that they make.

        Raises InputError where they can push to one side of an axis only.
        """
        low, high = self.thrusters.least_and_largest_force_by_axis()
        if not (low < 0.0).all():
            found = "thrusters that push to one side of an axis only"
            raise InputError(
                self.where, "", found, "forces ahead and astern, to port and starboard"
            )
        rate = self.thrusters.largest_force_rate_by_axis()
        return replace(vessel, thrusters=self.thrusters, tau_min=low, tau_max=high, rate_max=rate)

    def choose_half_turns(self, vessel: Vessel, file: Path) -> "OwnThrusters":
        """Return the thrusters with half turns that controllers plan with for wider sectors.

        file : that the vessel will be written to, for the lines.

        Of three for each azimuth that with which the fitted vessel holds the most wind off the bow,
        after the loss that leaves least, then the next, at last intact; the first in the order of
        `_list_half_turns` of those that are equal to 0.1 m/s. The first round begins with whole
        sectors, the second has what the first chose for the others.
        """
        # Controllers keep their sectors after a loss.
        every = [replace(thruster, barred_protects="") for thruster in self.thrusters.thrusters]
        tables = list(self.tables)
        wide = [i for i, t in enumerate(every) if t.convex_sector_rad != t.sector_rad]
        lines_by_azimuth = {}
        for i in 2 * wide:
            thruster, tried = self.thrusters.thrusters[i], {}
            for half in _list_half_turns(thruster):
                every[i] = replace(thruster, sector_rad=half, barred_protects="")
                fitted = replace(self.thrusters, thrusters=tuple(every))
                by_side = find_winds_by_side(replace(vessel, thrusters=fitted))
                tried[half] = next(iter(by_side.values()))
            # Of equals `max` takes the first.
            best = max(tried, key=lambda half: _list_winds_as_compared(tried[half]))
            every[i] = replace(thruster, sector_rad=best, barred_protects="")
            lines_by_azimuth[i] = _describe_half_turns(thruster.name, tried, best)
            half_deg = [round(math.degrees(angle) % 360.0, 9) for angle in best]
            tables[i] = tables[i].model_copy(update={"controller_sector_deg": half_deg})
        thrusters = replace(self.thrusters, thrusters=tuple(t.build_thruster() for t in tables))
        lines = [line for of_one in lines_by_azimuth.values() for line in of_one]
        if lines:
            command = f"dpbench capability {file} --planned"
            lines += ["To show the wind lost through these half turns, run:", f"  {command}"]
        return replace(self, tables=tuple(tables), thrusters=thrusters, half_turns=tuple(lines))


def _list_half_turns(thruster: Thruster) -> list[tuple[float, float]]:
    """Return half turns of an azimuth's wider sector: middle, from its start, to its end."""
    assert thruster.sector_rad and thruster.convex_sector_rad, "a sector wider than a half turn"
    start, end = thruster.sector_rad
    return [thruster.convex_sector_rad, (start, start + math.pi), (end - math.pi, end)]


def _describe_half_turns(
    name: str,
    tried: Mapping[tuple[float, float], Mapping[str, WindLimit]],
    best: tuple[float, float],
) -> list[str]:
    """Return lines, with a table, on the winds held with each half turn tried and the choice."""
    winds = {half: _list_winds_as_compared(held) for half, held in tried.items()}
    cases = {INTACT: "intact"} | {case: f"after {case}" for case in tried[best] if case != INTACT}
    rows = [("wind held [m/s]", *map(format_sector, tried))]
    for case, label in cases.items():
        held = (f"{floor_to_tenth(of_half[case].wind_mps):.1f}" for of_half in tried.values())
        rows.append((textwrap.shorten(label, 27, placeholder=" …"), *held))
    equal = [format_sector(half) for half in tried if winds[half] == winds[best]]
    tie = (
        f"{join_with_and(equal)} are equal within 0.1 m/s. Ties go to the middle half turn, then "
        "to the one that starts at the end of the barred zone."
    )
    return [
        f"{name}: controllers plan with {format_sector(best)}. Of three half turns, this one holds "
        "the most wind off the bow after the worst loss; if equal, after the next loss, then "
        "intact.",
        *("  " + f"{row[0]:<28}" + "".join(f"{cell:>16}" for cell in row[1:]) for row in rows),
        *([tie] if len(equal) > 1 else []),
    ]


def _list_winds_as_compared(held: Mapping[str, WindLimit]) -> list[float]:
    """Return the winds held [m/s] after losses, the least first, and intact; down to 0.1 m/s."""
    losses = sorted(limit.wind_mps for case, limit in held.items() if case != INTACT)
    return [floor_to_tenth(wind) for wind in (*losses, held[INTACT].wind_mps)]


def _sort_winds(held: Mapping[str, WindLimit]) -> list[float]:
    """Return the winds held in all failure cases [m/s], the least first, without their rounding."""
    return sorted(round(limit.wind_mps, 3) for limit in held.values())


def find_winds_by_side(vessel: Vessel) -> dict[float, dict[str, WindLimit]]:
    """Return the winds held by failure case from both sides of the bow [°], the worse side first.

    The side with less after the worst loss; if equal, after the next, then intact. A loss after
    which no sea is held counts too. Starboard where both are alike.
    """
    by_side = {side_deg: _find_winds_from(vessel, side_deg) for side_deg in SIDES_DEG}
    return dict(sorted(by_side.items(), key=lambda side: _sort_winds(side[1])))


def _explain_side(by_side: Mapping[float, Mapping[str, WindLimit]]) -> str:
    """Return a sentence on the side from which the sea comes, the first, and why."""
    (from_deg, _), (other_deg, _) = by_side.items()
    side, other = (
        f"{'port' if deg > 180.0 else 'starboard'} ({deg:g}°)" for deg in (from_deg, other_deg)
    )
    orders = [
        sorted(held, key=lambda case: round(held[case].wind_mps, 3)) for held in by_side.values()
    ]
    equal: dict[str, None] = {}
    for cases in zip(*orders, strict=True):
        winds = [held[case].wind_mps for case, held in zip(cases, by_side.values(), strict=True)]
        first, second = (
            f"{format_wind_held(wind)} {'intact' if case == INTACT else f'without {case}'}"
            for case, wind in zip(cases, winds, strict=True)
        )
        if round(winds[0], 3) < round(winds[1], 3):
            alike = f" From both sides alike, it holds {join_with_and([*equal])}." if equal else ""
            return (
                f"weather from {side}: there the ship holds less, {first}, than from {other}, "
                f"{second}.{alike}"
            )
        equal |= dict.fromkeys((first, second))
    return f"weather from {side}: the ship holds as much wind from {other}."


def _find_winds_from(vessel: Vessel, from_deg: float) -> dict[str, WindLimit]:
    """Return the largest wind held from a direction [°], by failure case."""
    plot = CapabilityPlot(vessel)
    from_rad = math.radians(from_deg)
    return {c.name: plot.find_wind_limit(c, from_rad) for c in plot.intact_and_failure_cases}


def read_own_thrusters(
    options: argparse.Namespace,
    numbers: dict[str, float | None],
    own: scaling.Particulars,
    like: str,
) -> OwnThrusters:
    """Return a new ship's thrusters from the file of an option, or from answers for `-`."""
    for option in FORCES:
        if numbers[option] is not None:
            both = f"--thrusters and --{option} exclude each other; give one of them"
            raise SituationError(WHERE, both)
    library, longer = load_vessel(like), own.length_m / scaling.LIBRARY[like].length_m
    rise_s = float(f"{library.tau_max[0] / library.rate_max[0] * longer**0.5:.3g}")
    asked = options.thrusters == "-"
    where = "thrusters" if asked else options.thrusters
    rows = _ask_for_rows() if asked else read_rows_of_thruster_table(Path(where))
    berth = Berth(own.length_m, own.breadth_m, rise_s)
    tables, thrusters = complete_thruster_values(rows, berth, where)
    share = scaling.compute_thrust_to_weight_ratio(own, float(thrusters.largest_thrusts_N.sum()))
    least, most = TO_WEIGHT
    if not least <= share <= most:
        total_kN = thrusters.largest_thrusts_N.sum() / 1e3
        found = f"{total_kN:.3g} kN in all, {share:.2g} times the ship's weight"
        allowed = f"{least:g} to {most:g} times the weight; check the units (kW, kN and m)"
        raise InputError(where, "power_kW, thrust_kN", found, allowed)
    return OwnThrusters(where, rows, tables, thrusters)


def _ask_for_rows() -> list[dict[str, str]]:
    """Return thrusters' rows as asked for on the terminal, or read line by line from a pipe."""
    rows: list[dict[str, str]] = []
    while True:
        row: dict[str, str] = {}
        for key in ASKED:
            if key == "thrust_kN" and "power_kW" in row:
                continue
            hint = f" ({HINTS[key]})" if HINTS[key] else ""
            print(f"thruster {len(rows) + 1}, {key}{hint}: ", end="", file=sys.stderr, flush=True)
            answer = sys.stdin.readline().strip()
            if not answer and key == "kind":
                print(file=sys.stderr)
                return rows
            if answer:
                row[key] = answer
        rows.append(row)


@dataclass(frozen=True)
class WeakSide:
    """The direction [°] of least wind held, after the loss of a group or intact without one.

    limit : the wind held from there then; intact : the least wind held intact, and from where [°].
    has_half_turns : whether these winds are held with the half turns that controllers plan with.
    """

    from_deg: float
    limit: WindLimit
    lost: str | None
    intact: tuple[float, WindLimit]
    has_half_turns: bool = False

    @property
    def is_held(self) -> bool:
        """True if the ship holds at least DP capability number 1 from there."""
        return self.limit.number > 0

    def find_number(self, number: int) -> int:
        """Return the largest DP capability number held from there, from 1 to `number`."""
        return max(1, min(number, self.limit.number))

    @property
    def when(self) -> str:
        """State of the ship in which the wind is held, as text."""
        return "intact" if self.lost is None else f"after the loss of {self.lost}"

    def explain_sea(self, number: int) -> str:
        """Return a sentence on the choice of its sea, up to a DP capability number."""
        where = f"from {self.from_deg:g}° {_name_method(self.has_half_turns)}"
        why = f"From {self.from_deg:g}°, the ship holds the least wind {self.when}"
        if not self.is_held:
            return f"the smallest, as the thrusters hold none {where}. {why}"
        return f"the largest up to number {number} that the thrusters hold {where}. {why}"

    def describe(self, number: int, path: Path) -> str:
        """Return a sentence on the scenario of a file with a sea up to a DP capability number."""
        from_deg, limit = self.intact
        winds = [f"{format_wind_held(limit.wind_mps)} from {from_deg:g}° intact"]
        if self.lost is not None:
            wind = format_wind_held(self.limit.wind_mps)
            winds.append(f"{wind} from {self.from_deg:g}° {self.when}")
        sea = f"DP capability number {self.find_number(number)}"
        if not self.is_held:
            sea += f", not held and not in the suite: dpbench run smoke --scenario {path}"
        what = "direction of least wind held"
        if self.has_half_turns:
            what += " with the half turns of controllers; the capability plot has all directions"
        return f"weak side ({what}): {', '.join(winds)} ({path.name}, {sea})"


@dataclass(frozen=True)
class HeldSea:
    """The DP capability number held by thrusters off the bow, if possible after a loss of a group.

    lost : the worst group without which a sea is held; None where there is none, and the number is
        that of the whole ship. losses : number held without each group, by rising wind.
    intact_mps : largest wind [m/s] held without a loss. reason : why this sea, for the scenario.
    from_deg : the side of the bow from which less is held; side : a sentence on it.
    planned : the plot with the half turns of controllers; None where they plan with the sectors of
        `capability`. remedies : what would help, as text, by group after whose loss no sea is held.
        weak_side : the direction of least wind held, after the loss of `lost` where there is one.
    """

    capability: Capability
    number: int
    lost: str | None
    losses: dict[str, int]
    intact_mps: float
    reason: str
    from_deg: float
    side: str
    planned: Capability | None
    remedies: dict[str, str]
    weak_side: WeakSide

    @property
    def method(self) -> str:
        """Method that gives these winds, as text."""
        return _name_method(self.planned is not None)

    @property
    def intact_number(self) -> int:
        """Largest DP capability number whose wind the intact ship holds off the bow, at least 1."""
        winds = scaling.DP_NUMBERS.items()
        return max((n for n, (mps, *_) in winds if mps <= self.intact_mps), default=1)

    def explain_sea(self, number: int) -> str:
        """Return text on the choice of a DP capability number, of the ship or the intact ship."""
        if number == self.number:
            return self.reason
        return f"the largest that the intact ship holds from {self.from_deg:g}° {self.method}"

    def describe_intact_sea(self, file: str) -> str:
        """Return a sentence on the scenario of a file with the intact ship in its largest sea."""
        wind_mps = scaling.DP_NUMBERS[self.intact_number][0]
        return (
            f"intact ship, without a loss: DP capability number {self.intact_number}, "
            f"wind {wind_mps:g} m/s from {self.from_deg:g}°, the largest that it holds from there "
            f"{self.method} ({file})"
        )

    def list_groups_not_held(self, number: int) -> list[str]:
        """Return the groups without which a DP capability number is not held, the worst first."""
        return [group for group, held_number in self.losses.items() if held_number < number]


def _name_method(has_half_turns: bool) -> str:
    """Return how a wind held is computed, as text: with half turns of azimuths or without."""
    return "according to level 1" + (
        " with the half turns of controllers" if has_half_turns else ""
    )


def find_held_sea(vessel: Vessel) -> HeldSea:
    """Return the largest sea that a ship's thrusters hold, according to level 1 of DNV-ST-0111.

    The plot has all directions of each azimuth, the sea those that controllers plan with.
    """
    with ProgressBar(transient=True) as bar:
        bar.remark("computing the wind that the thrusters hold")
        capability = compute_capability(CapabilityPlot(vessel), bar)
    assert vessel.thrusters is not None, "asked of ships with thrusters"
    planned = replace(vessel, thrusters=vessel.thrusters.copy_with_convex_sectors())
    by_side = find_winds_by_side(planned)
    from_deg, held = next(iter(by_side.items()))
    losses = sorted((case for case in held if case != INTACT), key=lambda c: held[c].wind_mps)
    worst, intact = losses[0], held[INTACT]
    lost = next((case for case in losses if held[case].number), None)
    halves = vessel.thrusters.has_half_turns
    method, most = _name_method(halves), max(scaling.DP_NUMBERS)
    largest = f"the largest at which the ship holds station {method}"
    if lost is not None:
        number, reason = held[lost].number, f"{largest}, intact and after the loss of "
        if lost == worst:
            reason += f"any failure group ({lost} is the worst)"
        else:
            reason += f"{lost}; it holds none after the loss of {worst}"
    elif intact.number:
        number, reason = intact.number, f"{largest} intact; it holds none after the loss of {worst}"
    else:
        number, reason = 1, f"the smallest, as the ship holds station in none {method}"
    numbers = {case: held[case].number for case in losses}
    number, intact_mps = min(number, most), intact.wind_mps
    remedies = {
        case: _find_remedy(
            vessel.thrusters,
            case,
            _find_winds_without_zones(vessel, from_deg)[case],
            capability.held[case][FROM_DEG.index(from_deg)].wind_mps,
        )
        for case in losses
        if not numbers[case]
    }
    with_halves = compute_capability(CapabilityPlot(planned)) if halves else None
    weak_side = _find_weak_side(with_halves or capability, lost, halves)
    return HeldSea(
        capability,
        number,
        lost,
        numbers,
        intact_mps,
        reason,
        from_deg,
        _explain_side(by_side),
        with_halves,
        remedies,
        weak_side,
    )


def _find_weak_side(capability: Capability, lost: str | None, has_half_turns: bool) -> WeakSide:
    """Return the direction of least wind held, after a loss where there is one; else intact.

    Starboard of equals.
    """

    def find_least(case: str) -> tuple[float, WindLimit]:
        limits = zip(FROM_DEG, capability.held[case], strict=True)
        return min(limits, key=lambda at: round(at[1].wind_mps, 3))

    return WeakSide(*find_least(lost or INTACT), lost, find_least(INTACT), has_half_turns)


def _find_winds_without_zones(vessel: Vessel, from_deg: float) -> dict[str, float]:
    """Return the largest wind [m/s] held from a direction [°] if azimuths had no barred zone."""
    assert vessel.thrusters is not None, "asked of ships with thrusters"
    turning = [
        replace(t, sector_rad=None, controller_sector_rad=None) for t in vessel.thrusters.thrusters
    ]
    free = replace(vessel, thrusters=replace(vessel.thrusters, thrusters=tuple(turning)))
    return {case: limit.wind_mps for case, limit in _find_winds_from(free, from_deg).items()}


def _find_remedy(thrusters: ThrusterSet, lost: str, free_mps: float, plot_mps: float) -> str:
    """Return what would hold a sea without a group, as text.

    free_mps : largest wind held without it if azimuths had no barred zone; plot_mps : that of the
        capability plot, with all directions that azimuths then have.
    """
    failed = thrusters.indices_by_failure_group[lost]
    left = [t for i, t in enumerate(thrusters.thrusters) if i not in failed]
    across = [t.x_m for t in left if t.kind != "main"]
    ends = {"bow": max(across, default=0.0) > 0.0, "stern": min(across, default=0.0) < 0.0}
    if missing := [end for end, is_there in ends.items() if not is_there]:
        place = " or the ".join(missing)
        remedy = (
            f"no tunnel or azimuth is left at the {place}; put one on every switchboard (group)"
        )
        if "stern" not in missing or all(thruster.kind != "main" for thruster in left):
            return remedy
        return f"{remedy}. Rudders are not modelled; those of a finished ship may hold a sea"
    if all(thruster.kind == "tunnel" for thruster in left):
        return "no main or azimuth is left; put one on every switchboard (group)"
    others = "a stronger thruster, or a retractable one on a switchboard of its own"
    if all(thruster.sector_rad is None for thruster in left):
        return f"the thrusters left at bow and stern are too weak; add {others}"
    if free_mps < scaling.DP_NUMBERS[1][0]:
        return (
            "the thrusters left at bow and stern are too weak even without barred zones; add "
            f"{others}"
        )
    limited = [t.name for t in left if t.sector_rad != t.convex_sector_rad]
    if limited and plot_mps >= scaling.DP_NUMBERS[1][0]:
        return (
            f"the cause is the half turn of {join_with_and(limited)} (controller_sector_deg); in "
            f"the capability plot, with all directions, {format_wind_held(plot_mps)} is held. To "
            f"hold a sea with the half turn, add {others}"
        )
    wind = format_wind_held(free_mps)
    return f"without barred zones {wind} would be held; narrow the zones, or add {others}"


def choose_sea(vessel: Vessel, held: HeldSea | None) -> int:
    """Return the DP capability number of a new ship by its thrusters, or else by its limits."""
    return scaling.find_largest_bearable_dp_number(vessel) if held is None else held.number


def choose_loss(held: HeldSea | None, number: int) -> str | None:
    """Return the group lost in a sea: the worst without which it is held; None without one."""
    return None if held is None or number > held.number else held.lost


def choose_further_losses(held: HeldSea | None, number: int) -> list[str]:
    """Return the groups lost in scenarios of their own, the weakest remainder first.

    With that of `choose_loss` they are `MOST_LOSSES` at most.
    """
    lost = choose_loss(held, number)
    others = [] if held is None else [group for group in held.losses if group != lost]
    return others[: MOST_LOSSES - (lost is not None)]


def describe_losses(
    held: HeldSea, number: int, at_s: float, files: Mapping[str, Path]
) -> list[str]:
    """Return lines: losses the files simulate, those they do not, what thrusters do not hold.

    files : the scenario of each group that is lost in one.
    """
    lines = [held.side]
    wind_mps = scaling.DP_NUMBERS[number][0]
    if wind_mps > held.intact_mps:
        lines.append(
            f"CAUTION: the wind of {wind_mps:g} m/s is beyond the "
            f"{format_wind_held(held.intact_mps)} that the thrusters hold from "
            f"{held.from_deg:g}° {held.method}."
        )
        if scaling.DP_NUMBERS[1][0] <= held.intact_mps:
            lines.append(_suggest_smaller_sea(held.intact_number, "intact"))
    # In the sea that is held, not where each loss is simulated whatever it leaves.
    held_after = choose_loss(held, number) if held.lost != next(iter(held.losses)) else None
    notes = {held_after: ", the worst after which a sea is held"}
    simulated = ", ".join(
        f"{group} ({path.name}{notes.get(group, '')})" for group, path in files.items()
    )
    lines.append(f"Scenarios with the loss of one failure group after {at_s:g} s: {simulated}")
    lines += _describe_losses_not_held(held, number)
    if left_out := describe_losses_left_out(held, [*files]):
        another = f"Name another in `lost` of {next(iter(files.values())).name}."
        lines.append(f"not simulated: {left_out}. {another}")
    return lines


def describe_losses_left_out(held: HeldSea, simulated: Sequence[str]) -> str:
    """Return a text on the groups whose loss is not simulated, and why; "" where every one is."""
    others = [group for group in held.losses if group not in simulated]
    why = f"simulated: the {MOST_LOSSES} losses with the least wind held"
    return f"the loss of {join_with_and(others)} ({why})" if others else ""


def _describe_losses_not_held(held: HeldSea, number: int) -> list[str]:
    """Return lines: after which losses a sea is not held, and what would change that."""
    weak = held.list_groups_not_held(number)
    if not weak:
        return []
    without = _name_groups_lost_one_by_one(weak)
    lines = [f"CAUTION: {held.method}, the thrusters do not hold this sea {without}."]
    by_sea: dict[int, list[str]] = {}
    for group in weak:
        by_sea.setdefault(held.losses[group], []).append(group)
    none = by_sea.pop(0, [])
    for smaller, groups in by_sea.items():
        lines.append(_suggest_smaller_sea(smaller, _name_groups_lost_one_by_one(groups)))
    if none:
        wind = f"a wind of {scaling.DP_NUMBERS[1][0]:g} m/s from {held.from_deg:g}°"
        lines.append(
            f"Not even DP capability number 1, {wind}, is held "
            f"{_name_groups_lost_one_by_one(none)}: a smaller --sea does not help. "
            "The remaining thrusters must push ahead, astern and to both sides, and turn the ship "
            "both ways."
        )
        lines += [f"After the loss of {group}: {held.remedies[group]}." for group in none]
    return lines


def _suggest_smaller_sea(number: int, when: str) -> str:
    """Return a sentence on the option for a DP capability number that is held."""
    return f"DP capability number {number} is held {when}: --sea {number}."


def _name_groups_lost_one_by_one(groups: Sequence[str]) -> str:
    """Return the names of groups that are lost one at a time, as text."""
    return " or ".join(f"without {group}" for group in groups)


def find_hardest_sea(vessel: Vessel, held: HeldSea | None) -> int:
    """Return the largest DP capability number held by the intact ship, by `held` or its limits."""
    if held is not None:
        return held.intact_number
    shares = {n: find_mean_share(vessel, n)[0] for n in scaling.DP_NUMBERS}
    return max((n for n, share in shares.items() if share <= 1.0), default=1)


def find_mean_share(vessel: Vessel, number: int, held: HeldSea | None = None) -> tuple[float, str]:
    """Return the mean force of a DP capability number as a share, and of what: limits or thrust."""
    if held is None or vessel.thrusters is None:
        return scaling.compute_limit_share_of_dp_number(vessel, number), "the limits"
    share = ThrusterReach(vessel.thrusters).find_least_thrust_share(
        -scaling.compute_mean_force_of_dp_number(vessel, number, held.from_deg)
    )
    return share, "the thrust"


def choose_limits(vessel: Vessel) -> str:
    """Return "attainable" if controllers with three forces can be limited by thrusters, else "box".

    Box limits where there are no thrusters, where one has a sector, or where the attainable set
    has more than `MOST_FACETS` facets.
    """
    every = vessel.thrusters
    if every is None or any(thruster.sector_rad is not None for thruster in every.thrusters):
        return "box"
    facets = len(
        build_attainable_force_polytope(
            every, ControllerTable.model_fields["attainable_sides"].default
        ).normals
    )
    return "attainable" if facets <= MOST_FACETS else "box"


def save_held_sea(held: HeldSea, vessel: Vessel, figure: Path | None) -> list[str]:
    """Write a chart of a ship's capability plot, if to a file; return lines to print."""
    wrote = ""
    if figure is not None:
        save_rose_figure(held.capability, vessel, figure)
        wrote = f"wrote {figure}: "
    cautions = [line for text in caution_on_rudders(vessel) for line in textwrap.wrap(text, WIDTH)]
    lines = [*cautions, f"{wrote}{format_notation(held.capability, vessel)}"]
    if held.planned is not None:
        notation = format_notation(held.planned, vessel)
        lines.append(f"with the half turns of the controllers: {notation}")
    return lines

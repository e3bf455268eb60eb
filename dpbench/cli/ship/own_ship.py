"""`dpbench init`: from the particulars of a ship to its vessel, scenario and suite file."""

import argparse
import json
import math
import os
import re
import shlex
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from dpbench.cli.ship.ideal_sensors import SENSOR_TABLES, describe_missing_tables
from dpbench.cli.ship.own_thrusters import (
    HeldSea,
    OwnThrusters,
    WeakSide,
    choose_further_losses,
    choose_limits,
    choose_loss,
    choose_sea,
    describe_losses,
    describe_losses_left_out,
    find_hardest_sea,
    find_held_sea,
    find_mean_share,
    read_own_thrusters,
    save_held_sea,
)
from dpbench.cli.terminal import WIDTH
from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.report.words import render_document
from dpbench.scenario import own_ship as scaling
from dpbench.scenario.hull_files import Hull, read_hull_from_csv_table, read_hull_from_mss_file
from dpbench.scenario.own_thrusters import ASSUMED_IN_SOURCE, describe_scaled_wind_areas
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.loads import DYNAMIC_FACTOR
from dpbench.ship.capability.losses import (
    MISCELLANEOUS,
    caution_on_wash,
    describe_unused_turning_rates,
    list_zone_cautions,
)
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import WATER_DENSITY

WHERE = "init"
COMMENT_WIDTH = 96
STEPS = 1000  # Steps of a scenario without a loss, as many as a p99 needs
LOST_FROM = 0.6  # Share of these steps after which thrusters are lost
SETTLED_S = 180.0
"""Earliest loss [s]: the weather has grown and the ship, which starts at rest, has settled."""
AFTER_LOSS_S = 420.0
"""Time simulated after a loss [s], and as long without one: a ship may leave its station slowly."""
SAMPLE_S = 0.3
INDENT = "  "
START_M = (1.2, 1.3)  # North and east; sample and start are the paper's
YAW_WEIGHT = 3000.0
"""Heading weight of the robust tuning of the paper's ship [1/rad²]; its lever is 0.72 L."""
MOVE_WEIGHT = 0.3
"""Weight of moves in multiples of 1/(maximum increment)². With the 0.1 of the paper's robust tuning
a lag of 2 s lost a ship of 45 m; with 1.0 a ship of little thrust swings by 3 m. Table of what was
tried: docs/guide/own-ship.md."""
LAG_S = 1.0
"""Time constant of thrusters [s] of a ship as long as the paper's: that of the propellers of the
supply vessel of 76.2 m in the MSS toolbox and the Python Vehicle Simulator (`T_n`)."""
FORM_DIFFERS = 0.2
"""Relative difference of a ratio from the library vessel's that counts as another form."""
CONTROL_HORIZON = 10
"""Control increments of each axis of force, or of each thruster's forces."""


@dataclass(frozen=True)
class OptionQuantity:
    """A numeric ship property given to `dpbench init`: meaning, unit and allowed range."""

    what: str
    unit: str
    least: float
    most: float

    def parse(self, option: str, text: str | None) -> float | None:
        """Return an option's text as a number, None for None; InputError outside its range."""
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not self.least <= value <= self.most:
            raise InputError(WHERE, f"--{option}", repr(text)[:80], self.allowed)
        return value

    @property
    def allowed(self) -> str:
        """Allowed range of a numeric option, with unit and meaning, as text."""
        return f"{self.least:g} to {self.most:.9g} {self.unit} ({self.what})"


QUANTITIES = {
    "length": OptionQuantity("length between perpendiculars", "m", 10, 500),
    "breadth": OptionQuantity("breadth", "m", 2, 100),
    "draught": OptionQuantity("draught", "m", 0.5, 40),
    "displacement": OptionQuantity("displacement", "t", 10, 1e6),
    "thrust": OptionQuantity("largest force ahead", "kN", 1, 1e5),
    "sway-thrust": OptionQuantity("largest force abeam", "kN", 1, 1e5),
    "yaw-moment": OptionQuantity("largest yaw moment", "kN·m", 1, 1e7),
}
PARTICULARS = ("length", "breadth", "draught", "displacement")
_KEYS = {"displacement": "displacement_t"} | {
    option: f"{option}_m" for option in ("length", "breadth", "draught")
}
BLOCK = (0.3, 1.0)  # Block coefficients of floating things; beyond them a unit is wrong
TO_WEIGHT = (5e-4, 0.2)  # Thrust over weight; the paper's ship has 0.028 ahead


def write_own_ship(options: argparse.Namespace) -> list[str]:
    """Write vessel, scenario and suite files of the user's ship; return lines to print.

    Without any particulars, and with `NAME.toml` there, the ship stays as it is and only scenario
    and suite of another sea are written.
    """
    name, folder = options.name, Path(options.out)
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,60}", name):
        raise InputError(WHERE, "NAME", repr(name)[:80], "1 to 60 letters, digits, _ and -")
    vessel_file = folder / f"{name}.toml"
    numbers = {
        option: quantity.parse(option, getattr(options, option.replace("-", "_")))
        for option, quantity in QUANTITIES.items()
    }
    sea = _parse_sea_number(options.sea)
    given = (options.from_mss, options.from_csv, options.like, options.thrusters)
    described = any(given) or any(numbers.values())
    texts: dict[str, str] = {}
    remarks: list[str] = []
    if described or not os.path.isfile(vessel_file):
        if not described and sea is not None:
            remedy = "give --length and the other data of a new ship"
            raise SituationError(WHERE, f"{vessel_file} does not exist; {remedy}")
        ship = _scale_new_ship(options, numbers)
        texts[vessel_file.name] = render_vessel_file(ship, _restate_command(options))
        vessel = ship.vessel
        remarks = [
            f"assumed: {ship.wind_areas}; enter yours in [windage] of {vessel_file.name} "
            "(frontal_m2, lateral_m2)",
            *list_cautions(ship),
        ]
        if ship.thrusters is not None:
            remarks.append("assumed for the thrusters:")
            remarks += [f"{INDENT}{sentence}" for sentence in ship.thrusters.assumed]
            thrusters = ship.thrusters.thrusters
            remarks += [*thrusters.sector_descriptions, *ship.thrusters.half_turns]
            remarks += [*caution_on_wash(thrusters), *list_zone_cautions(thrusters)]
            if unused := describe_unused_turning_rates(thrusters):
                remarks.append(f"{unused} The scenarios written here do not.")
    else:
        if sea is None:
            instead = (
                f"give --sea (1 to {max(scaling.DP_NUMBERS)}) to use it, or give the data of the "
                "ship and --force to overwrite it"
            )
            raise SituationError(WHERE, f"{vessel_file} exists; {instead}")
        vessel = load_vessel(vessel_file)
    held = None if vessel.thrusters is None else find_held_sea(vessel)
    number = choose_sea(vessel, held) if sea is None else sea
    stem = name if sea is None else f"{name}_sea{number}"
    # The plot is of the ship, not of a sea.
    is_drawn = held is not None and vessel_file.name in texts
    figure = folder / f"{name}_capability.svg" if is_drawn else None
    texts |= _render_sea_files(name, vessel, number, held, chosen=sea is None)
    _write_new_files(folder, texts, figure, force=options.force)
    drawn: list[str] = []
    if held is not None:
        drawn = save_held_sea(held, vessel, figure)
        files = _name_loss_files(stem, held, number)
        paths = {group: folder / file for group, file in files.items()}
        remarks += describe_losses(held, number, _find_time_of_loss(vessel), paths)
        remarks.append(held.weak_side.describe(number, folder / _name_weak_side_file(stem)))
        if _name_intact_file(stem) in texts:
            remarks.append(held.describe_intact_sea(_name_intact_file(stem)))
    harder = _suggest_harder_sea(folder, vessel, number, held)
    written = _list_files_and_commands(folder, texts, vessel, number, held, remarks)
    return [*drawn, *written, *harder]


def _render_sea_files(
    name: str, vessel: Vessel, number: int, held: HeldSea | None, *, chosen: bool
) -> dict[str, str]:
    """Return texts, by file name, of scenario and suite files for a DP capability number."""
    stem = name if chosen else f"{name}_sea{number}"
    weather = f"{name}_weather.toml" if chosen else f"{stem}.toml"
    texts = {weather: render_scenario_file(name, vessel, number, held, chosen=chosen)}
    steered, apart, left_out = [], {}, ""
    if held is not None:
        losses = _name_loss_files(stem, held, number)
        groups = {file: group for group, file in losses.items()}
        steered = list(dict.fromkeys([f"{stem}_thrusters.toml", *groups]))
        for file in steered:
            texts[file] = render_scenario_file(
                name, vessel, number, held, chosen=chosen, steered=True, lost=groups.get(file)
            )
        left_out = describe_losses_left_out(held, [*losses])
        weak = held.weak_side
        if weak.is_held:
            apart[_name_weak_side_file(stem)] = (
                "The weak side: weather from the direction of the least wind held."
            )
        texts[_name_weak_side_file(stem)] = render_scenario_file(
            name, vessel, number, held, chosen=chosen, steered=True, lost=weak.lost, weak=weak
        )
        if chosen and held.intact_number > number:
            apart[_name_intact_file(stem)] = (
                "The intact ship in the largest sea that it holds off the bow."
            )
            texts[_name_intact_file(stem)] = render_scenario_file(
                name, vessel, held.intact_number, held, chosen=chosen, steered=True
            )
    suite = render_suite_file(name, weather, vessel, number, steered, left_out, apart)
    return texts | {f"{stem}_suite.toml": suite}


def _name_weak_side_file(stem: str) -> str:
    """Return the file name of the scenario with weather from the weak side."""
    return f"{stem}_weak_side.toml"


def _name_intact_file(stem: str) -> str:
    """Return the file name of the scenario with the intact ship in the largest sea it holds."""
    return f"{stem}_intact.toml"


def _name_loss_files(stem: str, held: HeldSea, number: int) -> dict[str, str]:
    """Return file names, by failure group, for scenarios of its loss; write nothing."""
    lost = choose_loss(held, number)
    files = {} if lost is None else {lost: f"{stem}_thrusters.toml"}
    for group in choose_further_losses(held, number):
        letters = re.sub(r"[^A-Za-z0-9]+", "_", group).strip("_")[:40] or "group"
        file = f"{stem}_loss_{letters}.toml"
        # Groups may differ in other letters alone.
        taken = file in files.values()
        files[group] = f"{stem}_loss_{letters}_{len(files)}.toml" if taken else file
    return files


def _parse_sea_number(text: str | None) -> int | None:
    """Return the DP capability number in a text, 1 to 9; None for None; InputError for others."""
    if text is not None and text not in map(str, scaling.DP_NUMBERS):
        allowed = f"1 to {max(scaling.DP_NUMBERS)} (DP capability number)"
        raise InputError(WHERE, "--sea", repr(text)[:80], allowed)
    return None if text is None else int(text)


def _scale_new_ship(options: argparse.Namespace, numbers: dict[str, float | None]) -> "OwnShip":
    """Return the user's ship, scaled from a library vessel by its numbers and a hull file."""
    if options.from_mss and options.from_csv:
        both = "--from-csv and --from-mss exclude each other; give one of them"
        raise SituationError(WHERE, both)
    hull: Hull | None = None
    if hull_file := options.from_mss or options.from_csv:
        hull = (
            read_hull_from_mss_file(Path(hull_file))
            if options.from_mss
            else read_hull_from_csv_table(Path(hull_file))
        )
    own = _read_particulars(numbers, hull)
    if options.like is not None and options.like not in scaling.LIBRARY:
        raise InputError(
            WHERE,
            "--like",
            repr(options.like)[:80],
            format_allowed_names(options.like, list(scaling.LIBRARY)),
        )
    like = options.like or scaling.find_most_similar_library_vessel(own)
    own_thrusters = None
    if options.thrusters is None:
        thrust = _read_thrust(numbers, own)
    else:
        own_thrusters = read_own_thrusters(options, numbers, own, like)
        thrust = own_thrusters.compute_thrust_limits()
    vessel = scaling.scale_library_vessel_to_own_ship(like, own, thrust, options.name)
    if own_thrusters is not None:
        vessel = own_thrusters.make_fitted_vessel(vessel)
        own_thrusters = own_thrusters.choose_half_turns(
            vessel, Path(options.out) / f"{options.name}.toml"
        )
        vessel = replace(vessel, thrusters=own_thrusters.thrusters)
    if hull is not None:
        vessel = replace(vessel, M=hull.M, D=hull.D, where=hull_file)
    return OwnShip(options.name, own, vessel, like, hull, own_thrusters)


def _read_particulars(numbers: dict[str, float | None], hull: Hull | None) -> scaling.Particulars:
    """Return length, breadth, draught and displacement; InputError if implausible."""
    values = {}
    for option in PARTICULARS:
        quantity = QUANTITIES[option]
        value = numbers[option]
        if value is None and hull is not None and _KEYS[option] in hull.particulars:
            value = quantity.parse(option, f"{hull.particulars[_KEYS[option]]:.9g}")
        if value is None:
            raise InputError(WHERE, f"--{option}", "nothing", quantity.allowed)
        values[option] = value
    length, breadth, draught, displacement = (values[option] for option in PARTICULARS)
    own = scaling.Particulars(length, breadth, draught, 1000.0 * displacement)
    if not BLOCK[0] <= own.block_coefficient <= BLOCK[1]:
        found = (
            f"{displacement:g} t in a block of {length:g} x {breadth:g} x {draught:g} m, a block "
            f"coefficient of {own.block_coefficient:.2g}"
        )
        raise InputError(
            WHERE, "--displacement", found, f"a coefficient of {BLOCK[0]:g} to {BLOCK[1]:g}"
        )
    return own


def _read_thrust(
    numbers: dict[str, float | None], own: scaling.Particulars
) -> scaling.ThrustLimits:
    """Return a new ship's thrust limits in N and N·m; InputError if implausible for its size."""
    for option, lever_m in (("thrust", 1.0), ("sway-thrust", 1.0), ("yaw-moment", own.length_m)):
        value = numbers[option]
        if value is None:
            continue
        share = scaling.compute_thrust_to_weight_ratio(own, 1000.0 * value / lever_m)
        if not TO_WEIGHT[0] <= share <= TO_WEIGHT[1]:
            weight = value / share
            unit = QUANTITIES[option].unit
            least, most = (float(f"{share * weight:.3g}") for share in TO_WEIGHT)
            allowed = f"{least:g} to {most:.9g} {unit}"
            raise InputError(WHERE, f"--{option}", f"{value:g}", f"{allowed} for this displacement")
    ahead = numbers["thrust"]
    if ahead is None:
        raise InputError(
            WHERE, "--thrust", "nothing", "the largest force ahead [kN], or --thrusters"
        )
    sway, yaw = (
        None if force is None else 1000.0 * force
        for force in (numbers["sway-thrust"], numbers["yaw-moment"])
    )
    return scaling.ThrustLimits(1000.0 * ahead, sway, yaw)


def _restate_command(options: argparse.Namespace) -> str:
    """Return the `dpbench init` command line that gives these options."""
    words = ["dpbench", "init", options.name]
    for option in (*QUANTITIES, "thrusters", "like", "from-mss", "from-csv", "sea"):
        value = getattr(options, option.replace("-", "_"))
        if value is not None:
            words += [f"--{option}", str(value)]
    return shlex.join(words)


def _write_new_files(
    folder: Path, texts: dict[str, str], figure: Path | None, *, force: bool
) -> None:
    """Write text files into a folder; SituationError if one or the figure exists, unless forced."""
    for path in filter(None, (*(folder / name for name in texts), figure)):
        if os.path.lexists(path) and not force:
            instead = "choose another name or folder (--out), or add --force to overwrite it"
            raise SituationError(WHERE, f"{path} exists; {instead}")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _list_files_and_commands(
    folder: Path,
    texts: dict[str, str],
    vessel: Vessel,
    number: int,
    held: HeldSea | None,
    remarks: list[str],
) -> list[str]:
    """Return lines on files written for a new ship, its load from weather, the next commands."""
    paths = [str(folder / name) for name in texts]
    share, whole = find_mean_share(vessel, number, held)
    lines = [f"wrote {path}" for path in paths]
    for remark in remarks:
        indent = INDENT if remark.startswith(INDENT) else ""
        lines += textwrap.wrap(remark, WIDTH, subsequent_indent=2 * indent)
    wind_mps = scaling.DP_NUMBERS[number][0]
    from_deg = scaling.FROM_DEG if held is None else held.from_deg
    sea = f"sea: DP capability number {number}, wind {wind_mps:g} m/s from {from_deg:g}°"
    mean = f"{sea}. The mean force of level 1 needs {100 * share:.0f} % of {whole}"
    if vessel.thrusters is not None:
        edge = f"{100 * scaling.SPARE:.0f} % ({MISCELLANEOUS:g} / {DYNAMIC_FACTOR:g})"
        mean += f"; at most {edge} is allowed"
    turn = "For another direction, edit from_deg and towards_deg in the scenario files."
    lines += textwrap.wrap(f"{mean}. {turn}", WIDTH)
    if share > 1.0:
        forces = "--sway-thrust, --yaw-moment" if vessel.thrusters is None else "--thrusters"
        smaller = " or choose a smaller sea (--sea)" if number > 1 else ""
        weak = "This ship cannot hold station in this sea. Give it more force"
        lines += textwrap.wrap(f"{weak} ({forces}){smaller}.", WIDTH)
    lines += textwrap.wrap(describe_missing_tables([*SENSOR_TABLES]), WIDTH)
    return [*lines, f"next: dpbench check {paths[0]}", f"      dpbench run {paths[-1]}"]


def _suggest_harder_sea(
    folder: Path, vessel: Vessel, number: int, held: HeldSea | None
) -> list[str]:
    """Return lines with the command for the largest sea the ship holds; none where this is it."""
    harder = find_hardest_sea(vessel, held)
    # A loss that is not held here is not held in a larger sea either.
    if harder <= number or (held is not None and held.list_groups_not_held(number)):
        return []
    share, whole = find_mean_share(vessel, harder, held)
    where = "" if folder == Path() else f" --out {folder}"
    wind_mps = scaling.DP_NUMBERS[harder][0]
    from_deg = scaling.FROM_DEG if held is None else held.from_deg
    about = (
        f"(more wind from the same direction: {wind_mps:g} m/s from {from_deg:g}°; mean force of "
        f"level 1: {100 * share:.0f} % of {whole}"
    )
    if held is not None and (lost := held.list_groups_not_held(harder)):
        which = "any loss" if len(lost) == len(held.losses) else "some losses"
        about += f"; not held after {which}"
    return [
        f"harder: dpbench init {vessel.id} --sea {harder}{where}",
        *textwrap.wrap(f"{about})", WIDTH, initial_indent="      ", subsequent_indent="      "),
    ]


@dataclass(frozen=True, eq=False)
class OwnShip:
    """The user's ship, scaled from a library vessel, with inertia and damping of its hull file."""

    name: str
    own: scaling.Particulars
    vessel: Vessel
    like: str
    hull: Hull | None
    thrusters: OwnThrusters | None = None

    @property
    def wind_areas(self) -> str:
        """Areas above the water as text, and where they are from."""
        windage = self.vessel.windage
        assert windage is not None, "as every library vessel"
        return describe_scaled_wind_areas(windage, self.like)

    @property
    def assumed_values(self) -> str:
        """Values that the user has not given, as text."""
        of_thrusters = "" if self.thrusters is None else self.thrusters.assumed_values
        return "; ".join(filter(None, (of_thrusters, self.wind_areas)))


def render_vessel_file(ship: OwnShip, command: str) -> str:
    """Return the text of a new ship's vessel file; comments quote the command that made it."""
    vessel = ship.vessel
    assert vessel.windage is not None and vessel.reflection is not None, "as every library vessel"
    added = np.diag(vessel.M) - scaling.compute_rigid_body_inertia(ship.own)
    added = added / scaling.estimate_added_mass_by_regression(ship.own)
    return render_document(
        "own_vessel.toml",
        assumed_in_source=ASSUMED_IN_SOURCE,
        **vars(ship),
        assumed_values=ship.assumed_values,
        command=command,
        comment=_wrap_as_comment,
        # TOML's escapes are those of JSON.
        quoted=partial(json.dumps, ensure_ascii=False),
        library=load_vessel(ship.like),
        forms=_compute_form_ratios(ship),
        fitted_mps=scaling.choose_speed_of_damping_fit_mps(ship.own.length_m),
        cautions=list_cautions(ship),
        added=dict(zip(("surge", "sway", "yaw"), added.tolist(), strict=True)),
        ranges=list(zip(vessel.tau_min, vessel.tau_max, strict=True)),
    )


def _wrap_as_comment(caller: Callable[[], str]) -> str:
    """Return the text that a template block encloses as wrapped lines of TOML comments."""
    text = " ".join(caller().split())
    lines = textwrap.wrap(text, COMMENT_WIDTH, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _compute_form_ratios(ship: OwnShip) -> list[tuple[str, float, float]]:
    """Return hull ratios L/B and L/∇^(1/3) of the user's ship and of its library vessel."""
    own, library = ship.own, scaling.LIBRARY[ship.like]
    volumes_m3 = own.displacement_kg / WATER_DENSITY, library.mass_kg / WATER_DENSITY
    slender = own.length_m / math.cbrt(volumes_m3[0]), library.length_m / math.cbrt(volumes_m3[1])
    broad = own.length_m / own.breadth_m, library.length_m / library.breadth_m
    return [("L/B", *broad), ("L/volume^(1/3)", *slender)]


def list_cautions(ship: OwnShip) -> list[str]:
    """Return warning sentences about the hull file or an unusual hull form."""
    if ship.hull is not None:
        return ship.hull.remarks
    others = [
        what
        for what, own, library in _compute_form_ratios(ship)
        if abs(own / library - 1.0) > FORM_DIFFERS
    ]
    if not others:
        return []
    differs = f"differ{'s' * (len(others) == 1)} by more than {100 * FORM_DIFFERS:.0f} %"
    return [f"CAUTION: the hull form is not that of {ship.like}: {' and '.join(others)} {differs}."]


def choose_sample_s(vessel: Vessel) -> float:
    """Return a new ship's MPC sample time [s]: 0.3 s, Froude-scaled, in steps of 0.05 s."""
    return max(0.05, round(round(_scale_sample_s(vessel) / 0.05) * 0.05, 2))


def _scale_sample_s(vessel: Vessel) -> float:
    """Return the sample time [s] of the paper's ship at a new ship's size, before rounding."""
    return SAMPLE_S * scaling.compute_froude_time_scale(vessel.length_m)


def render_scenario_file(
    name: str,
    vessel: Vessel,
    number: int,
    held: HeldSea | None = None,
    *,
    chosen: bool,
    steered: bool = False,
    lost: str | None = None,
    weak: WeakSide | None = None,
) -> str:
    """Return the text of a new ship's scenario file in the sea of a DP capability number.

    held : what its thrusters hold; chosen : dpbench chose the sea, not the user; steered : the
    controller steers thrusters, from rest; lost : the group that it loses; weak : the weak side
    from which the weather comes, with a DP capability number of its own.
    """
    longer = scaling.compute_froude_time_scale(vessel.length_m) ** 2
    step_s = choose_sample_s(vessel)
    why = _explain_sea_choice(vessel, number, held, chosen=chosen)
    from_deg = held.from_deg if held else scaling.FROM_DEG
    if weak is not None:
        why, from_deg = weak.explain_sea(number), weak.from_deg
        number = weak.find_number(number)
    wind_mps, hs_m, *_ = scaling.DP_NUMBERS[number]
    return render_document(
        "own_scenario.toml",
        comment=_wrap_as_comment,
        quoted=partial(json.dumps, ensure_ascii=False),
        name=name,
        number=number,
        most=max(scaling.DP_NUMBERS),
        why=why,
        share=find_mean_share(vessel, number, held)[0],
        held=held,
        steered=steered,
        is_weak=weak is not None,
        fault=lost and {"at_s": _find_time_of_loss(vessel), "lost": lost},
        is_held=weak is None and lost == choose_loss(held, number),
        limits=choose_limits(vessel),
        wind_mps=wind_mps,
        hs_m=hs_m,
        port=from_deg > 180.0,
        off_bow_deg=min(from_deg, 360.0 - from_deg),
        step_s=step_s,
        scaled_s=_scale_sample_s(vessel),
        steps=_find_step_of_loss(vessel) + math.ceil(AFTER_LOSS_S / step_s) if steered else STEPS,
        start=[round(metres * longer, 2) for metres in START_M],
        start_m=math.hypot(*START_M) * longer,
        control_horizon=CONTROL_HORIZON,
        sea=scaling.make_environment_of_dp_number(number, from_deg),
        lag_s=round(LAG_S * scaling.compute_froude_time_scale(vessel.length_m), 2),
        move_weight=MOVE_WEIGHT,
        # A lever that grows with the ship.
        yaw_weight=float(f"{YAW_WEIGHT * longer**2:.3g}"),
    )


def _find_step_of_loss(vessel: Vessel) -> int:
    """Return the step at which a new ship's scenario loses thrusters."""
    return max(round(LOST_FROM * STEPS), math.ceil(SETTLED_S / choose_sample_s(vessel)))


def _find_time_of_loss(vessel: Vessel) -> float:
    """Return the time [s] at which a new ship's scenario loses thrusters."""
    return round(_find_step_of_loss(vessel) * choose_sample_s(vessel), 2)


def _explain_sea_choice(vessel: Vessel, number: int, held: HeldSea | None, *, chosen: bool) -> str:
    """Return a sentence on why this sea was chosen for a new ship's scenario."""
    if not chosen:
        return "as requested"
    if held is not None:
        return held.explain_sea(number)
    share, _ = find_mean_share(vessel, number)
    limit = f"whose mean force takes at most {100 * scaling.SPARE:.0f} % of the limits"
    if share <= scaling.SPARE:
        return f"the largest {limit}"
    return f"the smallest, as there is none {limit}"


def render_suite_file(
    name: str,
    weather: str,
    vessel: Vessel,
    number: int,
    steered: Sequence[str] = (),
    left_out: str = "",
    apart: Mapping[str, str] | None = None,
) -> str:
    """Return the text of a suite file that compares solvers in a new ship's scenarios.

    steered : files of the scenarios whose controller steers thrusters; the first is replayed, too;
    left_out : the losses that none of them simulates, and why; apart : by file of a scenario with
    another sea, the sentence on it.
    """
    lost_from = _find_step_of_loss(vessel)
    return render_document(
        "own_suite.toml",
        steered=steered,
        left_out=left_out,
        apart=apart or {},
        comment=_wrap_as_comment,
        quoted=partial(json.dumps, ensure_ascii=False),
        variables=vessel.thrusters and steered and CONTROL_HORIZON * vessel.thrusters.n_f,
        variables_of_forces=CONTROL_HORIZON * len(vessel.tau_max),
        title=f"{name}: comparison of solvers in the sea of DP capability number {number}",
        weather=[weather],
        steps=STEPS,
        lost_from=lost_from if steered else 0,
        analysed=steered[0] if steered else "",
        vessel=f"{name}.toml" if steered else "",
        first=lost_from - round(LOST_FROM * STEPS),
        step_s=choose_sample_s(vessel),
    )

"""What `dpbench check` says: of a sequence or a suite a line, of a ship a dozen of 80 columns."""

from __future__ import annotations

import difflib
import os
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.design import OFFSETS_M, Bracket, held_in_still_water, is_held
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import SuiteFile, load_suite, naming
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.sequences.verify import verify_sequence
from dpbench.cli.terminal import WIDTH
from dpbench.errors import InputError
from dpbench.report.documents.sent import SENDER, check_sent
from dpbench.report.formats import rounded_down, rounded_up, significant
from dpbench.scenario.problem_files import (
    KINDS,
    SEQUENCES,
    is_stored,
    problem_names,
    problem_path,
    read_toml,
    sequence_path,
)
from dpbench.scenario.scenario import Scenario, load_scenario, load_vessel
from dpbench.ship.characteristics import (
    SWAY,
    axis_time_constants_s,
    largest_current_abeam_mps,
    mean_load,
    sideways_force,
    slow_speed,
    steady_speed,
)
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

CHECKED = (
    "a vessel, scenario, scenario@vessel, suite or sequence by name, a TOML file, "
    "a .npz or a folder of problems by qpsolvers, a folder of results/community"
)
"""What `dpbench check` takes."""
CONTROLLERS = ("paper", "rough")
"""The scenarios whose controllers a vessel is tried with: the paper's 30/5 and the robust 60/10."""
_SPEEDS = ("m/s", "m/s", "°/s")
_DEGREES = np.array([1.0, 1.0, np.degrees(1.0)])
_KILO = np.array([1e3, 1e3, 1e3])
_TRIALS = 2 * len(OFFSETS_M)


def check_file(asked: str, progress: Progress | None = None) -> str:
    """Check what `run` takes, by its name or path; what it is, in one line, or a dozen of a ship.

    That is a vessel, scenario (`rough`, `rough@osv`) or suite, a sequence, or a problem or a folder
    of problems by qpsolvers; or a folder of results that was sent to us. Every optimum is
    certified, which may take a while.

    Raises
    ------
    InputError : naming file, key, what was found and what is allowed.
    """
    if is_stored(asked):
        return verify_sequence(sequence_path(asked), progress)
    # A scenario and a suite may have one name.
    paths = [problem_path(kind, asked) for kind in KINDS if asked in problem_names(kind)]
    if paths:
        return "\n".join(_check_document(path, progress) for path in paths)
    if any(os.path.isfile(os.path.join(asked, name)) for name in (SENDER, "runs.parquet")):
        return check_sent(Path(asked))
    # Unlike Path.exists, these are False for a name that is too long to exist.
    if os.path.isdir(asked) or asked.endswith(".npz"):
        return verify_sequence(Path(asked), progress)
    if os.path.isfile(asked):
        return _check_document(Path(asked), progress)
    if "@" in asked:
        return scenario_text(asked, load_scenario(asked), progress)
    if asked.endswith(".toml") or "/" in asked:
        raise InputError(asked, "", "no such file or folder", CHECKED)
    raise _unknown(asked)


def _unknown(asked: str) -> InputError:
    """The error of a name that nothing has, with the nearest names of all kinds."""
    names = [name for kind in (*KINDS, SEQUENCES) for name in problem_names(kind)]
    near = difflib.get_close_matches(asked, names, n=3)
    hint = f"e.g. {', '.join(near)}; " if near else ""
    shown = repr(asked if len(asked) <= 80 else f"{asked[:77]}...")
    return InputError("check", "", shown, f"{hint}{CHECKED}; `dpbench list` has the names")


def _check_document(file: Path, progress: Progress | None) -> str:
    """A TOML file, recognised by its tables."""
    document = read_toml(file)
    if "limits" in document or "thrusters" in document:
        return vessel_text(file, load_vessel(file), progress)
    if "controller" in document or "environment" in document:
        return scenario_text(file, load_scenario(file), progress)
    of_suite = SuiteFile.tables_of_cells()
    if any(table in document for table in of_suite):
        suite_path, suite = load_suite(file)
        with naming(suite_path):
            return f"{file}: a suite of {len(plan(suite, beside=suite_path.parent))} cells"
    raise InputError(
        str(file),
        "",
        f"tables {', '.join(document) or '(none)'}",
        "[limits] or [[thrusters]] (a vessel), [controller] and [environment] (a scenario), "
        f"or {', '.join(f'[[{table}]]' for table in of_suite)} (a suite)",
    )


def vessel_text(file: Path, vessel: Vessel, progress: Progress | None = None) -> str:
    """A vessel: its numbers, and up to which offset the two tunings bring it back."""
    tuned = [load_scenario(f"{name}@{file.resolve()}") for name in CONTROLLERS]
    first = f"{file.name}: a vessel, {vessel.title}"
    return _lines([first, *ship_lines(vessel), *_held_lines(tuned, progress)])


def scenario_text(name: str | Path, scenario: Scenario, progress: Progress | None = None) -> str:
    """A scenario: its ship's numbers, what its weather asks, and what its tuning holds."""
    shown = name.name if isinstance(name, Path) else name
    first = f"{shown}: a scenario of {scenario.steps} steps with vessel {scenario.vessel.id}"
    about = [*ship_lines(scenario.vessel), _weather_line(scenario)]
    return _lines([first, *about, *_held_lines([scenario], progress)])


def _lines(lines: Sequence[str]) -> str:
    first, *others = lines
    return "\n".join([textwrap.shorten(first, WIDTH, placeholder=" …"), *others])


def ship_lines(vessel: Vessel) -> list[str]:
    """The numbers of a vessel as an aligned table of three axes, and its force sideways."""
    kilo, per = ("k", 1e3) if vessel.tau_max[0] >= 1e3 else ("", 1.0)
    limits = zip(vessel.tau_min / per, vessel.tau_max / per, strict=True)
    units = (f"{kilo}N", f"{kilo}N", f"{kilo}N·m")
    force = [f"{_range(*pair)} {unit}" for pair, unit in zip(limits, units, strict=True)]
    rise = vessel.tau_max / vessel.rate_max
    reach = vessel.reachable_acceleration()[1] * _KILO
    drift = _with_units(steady_speed(vessel)[1] * _DEGREES, _SPEEDS, slow_speed(vessel) * _DEGREES)
    rows = [
        ("", "surge", "sway", "yaw"),
        ("largest force", *force),
        ("zero to full in", *(f"{_short(t)} s" for t in rise)),
        ("time constant", *(f"{_short(t)} s" for t in axis_time_constants_s(vessel))),
        ("acceleration at full", *_with_units(reach, ("mm/s²", "mm/s²", "mrad/s²"))),
        ("linear drift at full", *drift),
    ]
    table = [f"{row[0]:<22}" + "".join(f"{cell:<19}" for cell in row[1:]) for row in rows]
    return [*(line.rstrip() for line in table), _sideways_line(vessel, f"{kilo}N", per)]


def _range(low: float, high: float) -> str:
    return f"±{_short(high)}" if low == -high else f"{_short(low)}..{_short(high)}"


def _with_units(values: Vector, units: Sequence[str], most: Vector | None = None) -> list[str]:
    """Numbers with units; what is beyond `most` is only said to be."""
    if most is None:
        return [f"{_short(value)} {unit}" for value, unit in zip(values, units, strict=True)]
    return [
        f"{_up_to(value, limit)} {unit}"
        for value, unit, limit in zip(values, units, most, strict=True)
    ]


def _up_to(value: float, most: float) -> str:
    return _short(value) if value <= most else f"> {significant(most, 2)}"


def _short(value: float) -> str:
    """Three digits; large numbers whole, without a point."""
    return f"{value:.0f}" if abs(value) >= 99.5 else significant(value)


def _sideways_line(vessel: Vessel, unit: str, per: float) -> str:
    """What 1 m/s sideways takes of the force there is, and the current that can be held."""
    needs = sideways_force(vessel)[SWAY] / per
    has = min(-vessel.tau_min[SWAY], vessel.tau_max[SWAY]) / per
    most = slow_speed(vessel)[SWAY]
    current = largest_current_abeam_mps(vessel)
    said = rounded_down(current, 2) if current <= most else f"> {significant(most, 2)}"
    held = f"holds {said} m/s of current abeam"
    return f"1 m/s sideways needs {_short(needs)} {unit} of {_short(has)}; {held}"


def _weather_line(scenario: Scenario) -> str:
    """The mean force of the weather at the reference over the limits against it."""
    vessel = scenario.vessel
    load = mean_load(vessel, scenario.environment, float(scenario.reference[2]))
    against = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    shares = ", ".join(f"{share:.0%}" for share in np.abs(load) / against)
    over = " - it cannot hold" if (np.abs(load) > against).any() else ""
    return f"mean force of its weather: {shares} of the limits{over}"


def _held_lines(tuned: Sequence[Scenario], progress: Progress | None) -> list[str]:
    """What each tuning holds in still water."""
    progress = progress or Silent()
    progress.start(_TRIALS * len(tuned))
    lines = []
    for scenario in tuned:
        trials = 0

        def holds(trial: Scenario, offset_m: float, sides: Sequence[float]) -> bool:
            nonlocal trials
            trials += 1
            progress.advance(1, f"sideways by {offset_m:g} m")
            return is_held(trial, offset_m, sides)

        bracket = held_in_still_water(scenario, holds)
        progress.advance(_TRIALS - trials, "")
        controller = scenario.controller.label
        # Offsets are at full size; a model ship's own are said.
        scale = Froude(float(scenario.files["vessel"]["model_scale"])).length
        lines.append(f"tuning {controller:<14} {_bracket_text(bracket, scale)}")
    return lines


def _bracket_text(bracket: Bracket, scale: float) -> str:
    holds = f"{float(rounded_down(scale * bracket.holds_m)):g}"
    if bracket.fails_m is None:
        return f"holds calm water, from {holds} m sideways and all below"
    fails = f"{float(rounded_up(scale * bracket.fails_m)):g}"
    if bracket.holds_m == 0.0:
        return f"does not hold calm water: {fails} m sideways is too much"
    return f"holds calm water, up to {holds} m sideways (not {fails} m)"

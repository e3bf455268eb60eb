"""Statement: pages that a control engineer can give to a classification society.

It is drawn as SVG and turned into PDF, and claims nothing that is not on its pages.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import vl_convert as vlc

from dpbench.analysis.records.machine import select_timed_replays
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.suites.capability import (
    CapabilityResult,
    ConsequenceAnalysis,
    build_capability_results,
    build_consequence_analyses,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.analysis.verdict.thruster_verdicts import copy_with_thruster_times
from dpbench.analysis.verdict.verdict import (
    Verdict,
    choose_solver,
    list_best_verdict_of_each_solver,
)
from dpbench.bench.capability.edge_qps import load_capability_plots
from dpbench.bench.plan.configurations import name_solvers_of_suite
from dpbench.bench.record.machine import describe_version
from dpbench.bench.record.result_folder import Results, hash_files
from dpbench.errors import InputError
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.charts.style import FAIL, INK, LINE, SOFT
from dpbench.report.commands_text import describe_commands, describe_machine_states, describe_turns
from dpbench.report.documents.loop_picture import LoopPicture, find_loop_picture
from dpbench.report.documents.pdf_pages import split_into_pages
from dpbench.report.formats import format_time, join_with_and, strip_markdown
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation, list_speed_margin_sentences
from dpbench.report.page.terms import DRAG_MISMATCH
from dpbench.report.ship.capability_text import (
    describe_answers_at_edge,
    describe_capability,
    describe_consequence_solver,
    describe_losses_held,
    describe_unanswered_qps,
    describe_worst_loss,
)
from dpbench.report.ship.controller_text import describe_controllers, list_model_gaps
from dpbench.report.ship.open_losses import find_open_losses
from dpbench.report.ship.ship_text import (
    describe_ship,
    describe_unmet,
    summarise_ships,
)
from dpbench.report.ship.thrust_text import list_thruster_uses
from dpbench.report.verdict.verdict_text import (
    describe_deployment,
    describe_hardest_wait,
    describe_judged_runs,
    describe_requirements,
    describe_selection,
    describe_stopped_runs,
    format_p99_interval,
    format_settings_with_other_states,
)
from dpbench.report.words import render_document
from dpbench.scenario.own_thrusters import (
    describe_own_wind_areas,
    list_assumptions_on_vessel,
    split_source,
)
from dpbench.scenario.scenario import Scenario
from dpbench.ship.capability.losses import caution_on_wash, list_thruster_cautions
from dpbench.ship.thrusters import describe_sector, format_directions
from dpbench.ship.vessel import Vessel
from dpbench.solvers.settings import resolve_settings_with_fixed_options

MOST_SHIPS = 5
WIDTH, HEIGHT, MARGIN = 595, 842, 30
"""A4 in points."""
LOAD_MISMATCH = (
    "No Munk moment of the current acts on the ship: compare mean loads with `dpbench check`."
)
HASHED = ("runs.parquet", "steps.parquet", "capability.parquet", "machine.json", "suite.json")


@dataclass(frozen=True)
class TextLine:
    """Line of text of the statement: size, weight, gap above it, colour.

    is_caption : whether the picture precedes it.
    """

    text: str
    size: float = 8.0
    bold: bool = False
    gap: float = 1.5
    colour: str = INK
    is_caption: bool = False


def make_statement_svg(folder: Path, results: Results, data: PageData) -> str:
    """Return the statement on the recommended solver as SVG, its A4 pages below each other.

    Raises InputError when nothing can be recommended, so that there is nothing to state.
    """
    chosen = choose_solver(data.verdicts).chosen
    if chosen is None or chosen.state != "pass":
        found = "no deployable configuration with the overall verdict pass"
        raise InputError(str(folder), "--statement", found, "results with a recommendation")
    picture = find_loop_picture(data, chosen.configuration.solver)
    caption = "" if picture is None else picture.caption
    text = _fill_statement(folder, results, data, chosen, caption)
    return _render_svg([*_format_lines(text)], picture)


def _wrap(text: str, size: float) -> list[str]:
    """Return the lines of a text, as a list, that fit the width at a font size [points]."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and size * _width_em(longer) > WIDTH - 2 * MARGIN:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _width_em(text: str) -> float:
    """Return the width of a text in DejaVu Sans [em], letters as wide as the widest of a class."""
    return sum(
        next((w for w, letters in _WIDTHS.items() if letter in letters), 0.79) for letter in text
    )


def write_statement(path: Path, folder: Path, results: Results, data: PageData) -> Path:
    """Write the statement on the recommended solver, as .pdf or .svg; return the path."""
    drawn = make_statement_svg(folder, results, data)
    if path.suffix == ".svg":
        write_bytes_to_file_or_pipe(path, drawn.encode())
    elif path.suffix == ".pdf":
        write_bytes_to_file_or_pipe(path, split_into_pages(vlc.svg_to_pdf(drawn), HEIGHT))
    else:
        raise InputError("--statement", "", str(path), "a file name that ends in .pdf or .svg")
    return path


_LOOKS: dict[str, dict[str, Any]] = {
    "#": {"size": 14, "bold": True},
    ">": {"size": 9, "colour": SOFT},
    "##": {"size": 10, "bold": True, "gap": 7.0},
    "!": {"size": 8.5, "bold": True, "colour": FAIL},
    "+": {"bold": True},
    "%": {"size": 7, "colour": SOFT, "is_caption": True},
    "`": {"size": 6.5, "gap": 0.0},
    "_": {"size": 9, "gap": 12.0},
}
"""Look of a line by the mark it begins with."""
WRAPPED = ("", "!", "+", "%")  # Marks of lines that may be longer than the page is wide
PICTURE_HEIGHT, ABOVE_PICTURE = 54.0, 14.0  # [points]
BOTTOM = 40  # Space below the last line of a page [points]
LEADING = 1.16  # Height of a line over the size of its letters
BOLD_WIDER = 1.15  # Width of bold letters over that of others
_WIDTHS = {
    0.28: "ijl'",
    0.32: "IJ .,·",
    0.37: ":;|/f-",
    0.42: "()[]tr!²",
    0.54: 'sz?_°"',
    0.6: "ckvxyLF",
    0.64: "abdeghnopqu0123456789PTYESµ",
    0.7: "ABCKRVXZ",
    0.84: "w+×±≤≥=<>",
    1.0: "mMW@%—…",
}
"""Largest width [em] of letters in DejaVu Sans; others are capitals of 0.79 em."""


def _height(line: TextLine) -> float:
    """Return the height [points] that a line takes on the page, with a picture before it."""
    picture = PICTURE_HEIGHT + ABOVE_PICTURE if line.is_caption else 0.0
    return picture + LEADING * line.size + line.gap


def _format_lines(text: str) -> Iterator[TextLine]:
    """Yield the lines of the statement's text, styled and wrapped."""
    for line in text.splitlines():
        mark, _, words = line.partition(" ")
        if mark not in _LOOKS:
            mark, words = "", line
        words, look = strip_markdown(words), _LOOKS.get(mark, {})
        wide = BOLD_WIDER if look.get("bold") else 1.0
        size = wide * look.get("size", TextLine.size)
        for number, part in enumerate(_wrap(words, size) if mark in WRAPPED else [words]):
            later = {"gap": 0.0, "is_caption": False} if number else {}
            yield TextLine(part, **look | later)


def _fill_statement(
    folder: Path, results: Results, data: PageData, chosen: Verdict, caption: str
) -> str:
    """Return the text of the statement: ship, solver, machine, limits, file hashes."""
    c, records = chosen.configuration, data.records
    plots = build_capability_results(records, load_capability_plots(folder))
    analyses = build_consequence_analyses(records)
    known = [s for s in map(records.build_scenario, records.scenarios) if s is not None]
    ships = _list_ships_by_importance(data.ships)
    options = resolve_settings_with_fixed_options(c.solver_settings, c.solver)
    by_solver = results.runs.groupby("solver")["solver_version"]
    versions = {name: ", ".join(sorted({str(v) for v in own if v})) for name, own in by_solver}
    timed = copy_with_thruster_times(records, data.requirements, chosen)
    vessels = {s.vessel.id: s.vessel for s in known}
    ships_by_title = group_by_key(vessels.values(), lambda vessel: vessel.title)
    loops = {ship.run.scenario for ship in ships}
    return render_document(
        "statement",
        made_by=describe_version(results.suite),
        ship=summarise_ships(data.ships),
        ship_lines=[list(describe_scenario(ship)) for ship in ships[:MOST_SHIPS]],
        more_ships=max(0, len(ships) - MOST_SHIPS),
        thrusters=_list_once(
            describe_thrusters(_list_thrusters_with_thrust(s.vessel, s.files["vessel"]))
            for s in {s.vessel.id: s for s in known}.values()
        ),
        sources=_list_once(split_source(vessel)[0] for vessel in vessels.values()),
        assumed=_list_once(
            text for vessel in vessels.values() for text in list_assumptions_on_vessel(vessel)
        ),
        controllers=describe_controllers([s for s in known if s.name in loops]),
        model_gaps=list_model_gaps(known),
        own_areas=_list_once(map(describe_own_wind_areas, vessels.values())),
        worst_losses=[text for plot in plots if (text := describe_worst_loss(records, plot))],
        cautions=_list_cautions(vessels.values()),
        held=_describe_held(records, plots, analyses),
        losses=find_open_losses(records, data.ships, plots, analyses),
        thruster_uses=list(list_thruster_uses(ships)),
        consequence_solver=describe_consequence_solver(records, c.solver),
        caption=caption,
        unmet=describe_unmet(ships, known),
        compared=[
            f"{solver} {versions[solver]}{format_settings_with_other_states(data.verdicts, v)} "
            f"{v.state}, {format_time(v.p99_ns)}"
            + format_p99_interval(v.p99_interval)
            + (f" ({Recommendation.why(v)})" if _needs_reason(v, data.requirements) else "")
            for v in list_best_verdict_of_each_solver(data.verdicts)
            for solver in [v.configuration.solver]
        ],
        selection=describe_selection(
            name_solvers_of_suite(
                results.suite.get("solvers", []),
                superseded=bool(results.suite.get("superseded", True)),
            ),
            [str(name) for name in versions],
        ),
        machine_state=describe_machine_states(select_timed_replays(records)),
        commands=describe_commands(records.all_runs, str(results.suite.get("started_utc") or "")),
        turns=describe_turns(records),
        c=c,
        v=chosen,
        timed=timed,
        wait=describe_hardest_wait(records, timed.longest_run),
        judged_runs_text=describe_judged_runs(chosen),
        version=versions[c.solver],
        numbers=", ".join(f"{key} = {value!r}" for key, value in options.items())
        or "the library's own",
        aboard=describe_deployment(c.solver),
        requirements=describe_requirements(data.requirements),
        unanswered=describe_unanswered_qps(records, c.solver),
        others_unanswered=[
            text
            for v in list_best_verdict_of_each_solver(data.verdicts)
            if v.configuration.solver != c.solver
            and (text := describe_unanswered_qps(records, v.configuration.solver))
        ],
        stopped=describe_stopped_runs(records.all_runs),
        slower=" ".join(list_speed_margin_sentences(data, chosen)),
        ships=[
            f"{title} ({', '.join(vessel.id for vessel in own)})"
            for title, own in ships_by_title.items()
        ],
        mismatch=f"{DRAG_MISMATCH} {LOAD_MISMATCH}"
        if any(vessel.drag for vessel in vessels.values())
        else "",
        experiments=[
            data.experiments[p].label
            for p in data.judged_experiment_indices
            if data.get_state_in_experiment(data.find_index(c), p) == "pass"
        ],
        machine=defaultdict(str, results.machine),
        hashes=hash_files(folder, HASHED) | _hash_documents(known),
        suite=defaultdict(str, results.suite),
    )


def _needs_reason(verdict: Verdict, requirements: Requirements) -> bool:
    """Return whether a verdict does not follow from its p99, as late with a p99 in the limit."""
    is_late_in_limit = verdict.state == "late" and verdict.p99_ns <= requirements.p99_ns
    return verdict.state == "inconclusive" or is_late_in_limit


def _list_once(texts: Iterable[str]) -> list[str]:
    """Return texts that are not empty, equal ones once."""
    return [*dict.fromkeys(filter(None, texts))]


def _list_ships_by_importance(ships: Sequence[ShipResult]) -> list[ShipResult]:
    """Return ships outside of studies: after a loss first, of these the one farthest off."""
    alone = [ship for ship in ships if not ship.run.study]
    return sorted(
        alone,
        key=lambda ship: (
            ship.state == "not run",
            not (ship.run.scenario_documents or {}).get("scenario", {}).get("faults"),
            not ship.has_left_station,
            0.0 if ship.state == "not run" else -ship.used_share_of_station_limits,
        ),
    )


def _describe_held(
    records: Records,
    plots: Sequence[CapabilityResult],
    analyses: Sequence[ConsequenceAnalysis],
) -> list[str]:
    """Return lines on a folder's DP capability plots and consequence analyses."""
    lines = [
        " ".join([*describe_capability(records, plot), describe_answers_at_edge(plot)])
        for plot in plots
    ]
    return [*lines, *(f"Consequence analysis: {describe_losses_held(one)}" for one in analyses)]


def _list_cautions(vessels: Iterable[Vessel]) -> list[str]:
    """Return lines on wash between azimuths, rudders that do not count, and zones of the push."""
    every = [vessel.thrusters for vessel in vessels if vessel.thrusters]
    cautions = ([*caution_on_wash(one), *list_thruster_cautions(one)] for one in every)
    return [*dict.fromkeys(text for own in cautions for text in own)]


def _hash_documents(scenarios: Sequence[Scenario]) -> dict[str, str]:
    """Return the SHA-256 of vessel and scenario documents as stored in `runs.parquet`, by name.

    Of their JSON with sorted keys. Equal documents have one hash, and more than `MOST_SHIPS`
    scenarios one for all, in their order.
    """
    documents: dict[str, Any] = {
        f"vessel {scenario.vessel.id}": scenario.files["vessel"] for scenario in scenarios
    }
    of_scenarios = {s.name: s.files["scenario"] for s in scenarios}
    if len(of_scenarios) <= MOST_SHIPS:
        documents |= {f"scenario {name}": own for name, own in of_scenarios.items()}
    else:
        documents[f"{len(of_scenarios)} scenarios"] = list(of_scenarios.values())
    hashes = {
        name: hashlib.sha256(
            json.dumps(document, sort_keys=True, ensure_ascii=False).encode()
        ).hexdigest()
        for name, document in documents.items()
    }
    equal = group_by_key(hashes, hashes.__getitem__)
    return {
        names[0] + f" and {len(names) - 1} equal" * (len(names) > 1) + " (stored document)": sha
        for sha, names in equal.items()
    }


def _render_svg(lines: Iterable[TextLine], picture: LoopPicture | None) -> str:
    """Return lines of text and the picture as one SVG page."""
    parts: list[str] = []
    y, pages = float(MARGIN), 1
    for line in lines:
        if y + _height(line) > HEIGHT * pages - BOTTOM:
            y, pages = float(HEIGHT * pages + MARGIN), pages + 1
        if line.is_caption and picture is not None:
            parts += picture.svg(MARGIN, y + ABOVE_PICTURE, WIDTH - 2 * MARGIN, PICTURE_HEIGHT)
        y += _height(line)
        weight = "600" if line.bold else "400"
        parts.append(_make_svg_text(y, line.size, line.colour, line.text, weight))
    for page in range(1, pages + 1):
        foot = HEIGHT * page - BOTTOM / 2
        parts.append(_make_svg_text(foot, 7.0, SOFT, f"Page {page} of {pages}"))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT * pages}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT * pages}" '
        'font-family="DejaVu Sans, Helvetica, Arial, sans-serif">'
        f'<rect width="{WIDTH}" height="{HEIGHT * pages}" fill="white"/>'
        f'<rect x="{MARGIN}" y="{MARGIN - 8}" width="{WIDTH - 2 * MARGIN}" height="1" '
        f'fill="{LINE}"/>' + "".join(parts) + "</svg>"
    )


def _make_svg_text(y: float, size: float, colour: str, text: str, weight: str = "400") -> str:
    """Return a line of text at the left margin as an SVG element."""
    return (
        f'<text x="{MARGIN}" y="{y:.1f}" font-size="{size:g}" font-weight="{weight}" '
        f'fill="{colour}">{escape(text)}</text>'
    )


def describe_scenario(ship: ShipResult) -> Iterator[str]:
    """Yield one line on a scenario: what became of the ship, its title, weather and losses."""
    yield describe_ship(ship)
    scenario = (ship.run.scenario_documents or {}).get("scenario")
    if scenario is not None:
        parts = [_describe_weather(scenario.get("environment") or {})]
        parts += [
            f"loss of {join_with_and(lost)} at {at_s:g} s" for at_s, lost in list_losses(ship.run)
        ]
        yield f"{scenario.get('title', ship.name)} ({'; '.join(parts)})"


def _describe_weather(environment: Mapping[str, Any]) -> str:
    """Return in words the mean wind, waves and current with directions; or that there are none."""
    wind, waves, current = (environment.get(key) for key in ("wind", "waves", "current"))
    parts = []
    if wind:
        parts.append(f"wind {wind['speed_mps']:g} m/s from {wind['from_deg']:g}°")
    if waves:
        height = f"Hs {waves['hs_m']:g} m, Tp {waves['tp_s']:g} s"
        parts.append(f"{height} from {waves['from_deg']:g}°")
    if current:
        parts.append(f"current {current['speed_mps']:g} m/s to {current['towards_deg']:g}°")
    if any(environment.get("mean_kN") or ()):
        surge, sway, yaw = environment["mean_kN"]
        parts.append(f"mean force {surge:g} kN, {sway:g} kN, {yaw:g} kN·m")
    return ", ".join(parts) or "no wind, waves or current"


def describe_thrusters(thrusters: Sequence[Mapping[str, Any]]) -> str:
    """Return the thrusters of a vessel document by switchboard, with powers, as text; or ""."""
    by_board = group_by_key(thrusters, lambda one: str(one.get("group") or "no group"))
    boards = [f"{board}: {', '.join(map(_name_thruster, own))}" for board, own in by_board.items()]
    return "; ".join(boards)


def _list_thrusters_with_thrust(
    vessel: Vessel, document: Mapping[str, Any]
) -> list[Mapping[str, Any]]:
    """Return the thruster tables of a vessel document, each with its thrust ahead."""
    thrusts_N = [] if vessel.thrusters is None else vessel.thrusters.largest_thrusts_N.tolist()
    tables = document.get("thrusters") or ()
    return [
        {**one, "thrust_kN": thrust_N / 1e3}
        for one, thrust_N in zip(tables, thrusts_N, strict=False)
    ]


def _name_thruster(thruster: Mapping[str, Any]) -> str:
    """Return a thruster's name and, where known, kind, propeller, place, power, thrust and push."""
    sector_deg = thruster.get("sector_deg")
    facts = [thruster["kind"]] if "kind" in thruster else []
    if thruster.get("propeller") not in (None, *facts):
        facts.append(f"propeller: {thruster['propeller']}")
    if "x_m" in thruster:
        facts.append(f"x {thruster['x_m']:g} m, y {thruster.get('y_m', 0.0):g} m")
    for key, unit in (("power_kW", "kW"), ("thrust_kN", "kN")):
        facts += [f"{thruster[key]:.4g} {unit}"] if thruster.get(key) else []
    facts += [describe_sector(*sector_deg)] if sector_deg else []
    if planned_deg := thruster.get("controller_sector_deg"):
        facts.append(f"controllers plan with {format_directions(*planned_deg)}")
    if protected := thruster.get("barred_protects"):
        facts.append(f"all directions after the loss of {protected} in the capability plot")
    return str(thruster["name"]) + (f" ({', '.join(facts)})" if facts else "")

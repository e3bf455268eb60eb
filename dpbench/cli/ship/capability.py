"""The command `dpbench capability`: the wind a ship holds, and the accuracy of solvers there."""

import argparse
import json
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import Answers, count_answers_by_run
from dpbench.bench.campaign import run_campaign
from dpbench.bench.capability.frontier import (
    FROM_DEG,
    INTACT,
    Capability,
    CapabilityPlot,
    WindLimit,
    compute_capability,
    is_beyond_standard_winds,
)
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.sequences.capability_boundary import write_capability_suite
from dpbench.cli.terminal import WIDTH, ProgressBar
from dpbench.errors import InputError
from dpbench.report.formats import floor_to_tenth, format_time, join_with_and
from dpbench.scenario.own_ship import DP_NUMBERS
from dpbench.scenario.own_thrusters import (
    describe_own_wind_areas,
    list_assumptions_on_vessel,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.loads import DP_CONDITIONS
from dpbench.ship.capability.losses import (
    caution_on_wash,
    list_thruster_cautions,
    list_zone_cautions,
)
from dpbench.ship.thrusters import format_sector
from dpbench.ship.vessel import Vessel
from dpbench.solvers.table import require_solver_available

SIDES = 24
"""Default sides of polygons: they lose 0.9 % of the thrust; de Wit (2009) recommends up to 1 %."""
FIGURES = (".svg", ".html", ".png", ".pdf")
_WIDE = 4  # Cases that fit beside each other
_CELL = 15
_SPARE = 4  # Of a cell, at its end
_PLANNED = 7  # Wind beside it that controllers plan with


def describe_capability(arguments: argparse.Namespace) -> str:
    """Return the largest wind that a vessel's thrusters hold, by direction, as text or JSON."""
    figure = None if arguments.figure is None else Path(arguments.figure)
    if figure is not None and figure.suffix not in FIGURES:
        allowed = f"a file name that ends in {', '.join(FIGURES[:-1])} or {FIGURES[-1]}"
        raise InputError("--figure", "", arguments.figure, allowed)
    if arguments.out is not None and not arguments.solver:
        raise InputError("--out", "", f"{arguments.out} without --solver", "the two together")
    for name in arguments.solver or ():
        if name != "all":
            require_solver_available(name)
    vessel = load_vessel(arguments.vessel)
    frontier, is_partial = CapabilityPlot(vessel, arguments.sides), bool(_list_half_turns(vessel))
    quiet = arguments.json
    with ProgressBar(transient=True, quiet=quiet) as bar:
        capability = compute_capability(frontier, bar)
        planned = capability if arguments.planned else None
        if planned is not None and is_partial:
            planned = _compute_planned(frontier, bar)
    if figure is not None:
        save_rose_figure(capability, vessel, figure, planned if is_partial else None)
    answers: list[Answers] = []
    out = Path(arguments.out or f"results/capability-{vessel.id}")
    if arguments.solver:
        answers = _judge_solvers(frontier, capability, out, arguments)
    if arguments.json:
        report = make_json_report(capability, vessel, answers, planned)
        return json.dumps(report, ensure_ascii=False, indent=2)
    lines = [
        *format_wind_table(capability, vessel, planned),
        *_suggest_closed_loops(capability, arguments.vessel),
    ]
    if answers:
        lines += ["", *format_answer_counts(answers), "", f"results in {out / 'run'}"]
    return "\n".join(lines)


def _compute_planned(frontier: CapabilityPlot, progress: ProgressBar) -> Capability:
    """Return a ship's wind limits with the half turns that controllers plan with for azimuths."""
    convex = replace(frontier.vessel, thrusters=frontier.thrusters.copy_with_convex_sectors())
    return compute_capability(CapabilityPlot(convex, frontier.sides), progress)


def _judge_solvers(
    frontier: CapabilityPlot, capability: Capability, out: Path, arguments: argparse.Namespace
) -> list[Answers]:
    """Run solvers on allocation QPs at a ship's wind limit; return counts of right answers."""
    solvers = None if "all" in arguments.solver else arguments.solver
    quiet = arguments.json
    if frontier.sides is None:
        frontier = CapabilityPlot(frontier.vessel, SIDES)
        with ProgressBar(transient=True, quiet=quiet) as bar:
            capability = compute_capability(frontier, bar)
    suite = write_capability_suite(frontier, capability, out)
    with ProgressBar(transient=True, quiet=quiet) as bar:
        folder = run_campaign(suite, out / "run", solvers=solvers, may_leave_out=True, progress=bar)
    records = Records(load_results(folder))
    return count_answers_by_run(records, [run for run in records.runs if run.default_route])


def save_rose_figure(
    capability: Capability, vessel: Vessel, path: Path, planned: Capability | None = None
) -> None:
    """Write a chart of the largest wind held by direction and failure case to a file."""
    from dpbench.report.charts.capability import COLUMNS as DRAWN, draw_capability_rose
    from dpbench.report.charts.render import save_figure

    plots = {"": capability} | ({} if planned is None else {", half turns": planned})
    rows = [
        (_name_curve(case) + ending, from_deg, at.wind_mps, at.number)
        for ending, plot in plots.items()
        for case, held in plot.held.items()
        for from_deg, at in zip(FROM_DEG, held, strict=True)
    ]
    chart = draw_capability_rose(
        pd.DataFrame(rows, columns=list(DRAWN)), f"{vessel.title}: largest wind held"
    )
    if planned is not None:
        chart.title.subtitle.append("half turns: directions in which the controllers plan")
    save_figure(chart, path)


def _name_curve(case: str) -> str:
    """Return a failure case as the legend of a chart names its curve."""
    return case if case == INTACT else f"without {case}"


def format_wind_table(
    capability: Capability, vessel: Vessel, planned: Capability | None = None
) -> list[str]:
    """Return the largest wind held, by direction and lost thrusters, as lines of 80 columns.

    planned : the same with the half turns that controllers plan with, in a column beside each; no
    columns where the controllers plan with all directions.
    """
    columns, explained = _list_columns(capability), _explain_planned(planned, vessel)
    planned = planned if _list_half_turns(vessel) else None
    room = _CELL - 2 - (0 if planned is None else _SPARE)
    heads = _format_heads([*columns], room, "" if planned is None else f"{'planned':<{_PLANNED}}")
    parts = [[_format_wind_limit(held) for held in column] for column in columns.values()]
    if planned is not None:
        for part, column in zip(parts, _list_columns(planned).values(), strict=True):
            for i, held in enumerate(column):
                part[i] = f"{part[i][:-_SPARE]}{floor_to_tenth(held.wind_mps):5.1f}  "
    cells = map("".join, zip(*parts, strict=True))
    rows = [
        f"{from_deg:4.0f}° {row}".rstrip() for from_deg, row in zip(FROM_DEG, cells, strict=True)
    ]
    shape = "circles" if capability.sides is None else f"{capability.sides}-sided polygons"
    about = (
        f"{vessel.id}: DP capability level 1 of DNV-ST-0111, thrust ranges of azimuths as {shape}. "
        "Largest wind held [m/s] and DP capability number, by the direction from which wind, "
        "waves and current come (90° is starboard); + marks the largest wind of the "
        "standard's table."
    )
    assumed = list_assumptions_on_vessel(vessel)
    notes = [*explained, *caution_on_rudders(vessel)]
    notes += _explain_notation(capability, vessel)
    notes += [f"Assumed: {'; '.join(assumed)}."] if assumed else []
    if own_areas := describe_own_wind_areas(vessel):
        notes.append(f"{own_areas[0].upper()}{own_areas[1:]}.")
    if every := vessel.thrusters:
        notes += every.sector_descriptions
        notes += [*caution_on_wash(every), *list_zone_cautions(every)]
    notes = [line for note in notes for line in textwrap.wrap(note, WIDTH)]
    return [*textwrap.wrap(about, WIDTH), "", *heads, *rows, "", *notes]


def _format_heads(names: Sequence[str], room: int, beside: str) -> list[str]:
    """Return the head of the table of winds, in as many lines as its longest name takes."""
    if all(len(name) <= room for name in names):
        return [f" from {''.join(f'  {name:<{room}}{beside}' for name in names)}".rstrip()]
    width = room + len(beside)
    wrapped = [textwrap.wrap(name, width) for name in names]
    most = max(map(len, wrapped))
    lines = zip(*([""] * (most - len(name)) + name for name in wrapped), strict=True)
    heads = ["".join(f"  {part:<{width}}" for part in line) for line in lines]
    if beside:
        heads.append(len(names) * f"  {'':<{room}}{beside}")
    return [*(f"      {head}".rstrip() for head in heads[:-1]), f" from {heads[-1]}".rstrip()]


def caution_on_rudders(vessel: Vessel) -> list[str]:
    """Return the sentence to print before a notation without rudders; none where all counts."""
    caution = "" if vessel.thrusters is None else vessel.thrusters.caution_on_rudders
    return [caution] if caution else []


def format_notation(capability: Capability, vessel: Vessel) -> str:
    """Return a DP capability notation; "without rudders" where mains alone push aft."""
    return f"{capability.notation}{' without rudders' if caution_on_rudders(vessel) else ''}"


def _list_columns(capability: Capability) -> dict[str, tuple[WindLimit, ...]]:
    """Return the cases that a table has columns for: all, or intact and the worst of many."""
    if len(capability.held) <= _WIDE:
        return dict(capability.held)
    return {
        INTACT: capability.held[INTACT],
        "worst failure": capability.limits_after_worst_failure,
    }


def _explain_planned(planned: Capability | None, vessel: Vessel) -> list[str]:
    """Return notes on the half turns that controllers plan with; none unless they are shown."""
    if planned is None or vessel.thrusters is None:
        return []
    halves = _list_half_turns(vessel)
    if not halves:
        return ["planned: the same, as controllers plan with all directions of each azimuth."]
    return [
        f"planned: the wind held with the half turn of each azimuth that controllers plan with, "
        f"as their QPs need convex sets of forces: {', '.join(halves)}; {planned.notation}."
    ]


def _list_half_turns(vessel: Vessel) -> list[str]:
    """Return the directions of controllers of azimuths for which the capability plot has more."""
    every = () if vessel.thrusters is None else vessel.thrusters.thrusters
    return [
        f"{thruster.name} {format_sector(convex)} of "
        + ("360°" if thruster.sector_rad is None else format_sector(thruster.sector_rad))
        for thruster in every
        if (convex := thruster.convex_sector_rad) is not None
        and (convex != thruster.sector_rad or thruster.barred_protects)
    ]


def _format_wind_limit(held: WindLimit) -> str:
    """Return the largest wind held [m/s] and its DP capability number as a table cell."""
    beyond = "+" if is_beyond_standard_winds(held) else " "
    return f"  {floor_to_tenth(held.wind_mps):5.1f}{beyond} {held.number:>2}".ljust(_CELL)


def _explain_notation(capability: Capability, vessel: Vessel) -> list[str]:
    """Return notes on a DP capability notation, its zeros, the thrusters lost."""
    lines = [
        f"{format_notation(capability, vessel)}: smallest number within 30° of the bow and in all "
        "directions, intact and after the worst failure."
    ]
    if any(at.number == 0 for held in capability.held.values() for at in held):
        wind_mps, hs_m, _, current_mps = DP_CONDITIONS[1]
        lines.append(
            f"Number 0: not even number 1 is held, a wind of {wind_mps:g} m/s with waves of "
            f"{hs_m:g} m and a current of {current_mps:g} m/s."
        )
    for case, names in capability.lost.items():
        if names and [*names] != [case]:
            verb = "is" if len(names) == 1 else "are"
            lines.append(f"Failure {case}: {join_with_and([*names])} {verb} lost.")
    return lines


def _suggest_closed_loops(capability: Capability, vessel: str) -> list[str]:
    """Return lines on what a static balance does not show, and on commands that show it."""
    about = (
        "This is a static balance of mean loads. In gusts, in waves or after a loss, the ship can "
        "still leave its station in closed loop. To simulate it:"
    )
    path = Path(vessel)
    if path.suffix != ".toml":
        commands = [f"dpbench run smoke --scenario thrusters@{vessel}"]
    else:
        number = min(max(capability.dp_capability_numbers[0], min(DP_NUMBERS)), max(DP_NUMBERS))
        folder = "" if path.parent == Path() else f" --out {path.parent}"
        suite = path.with_name(f"{path.stem}_sea{number}_suite.toml")
        commands = [
            f"dpbench init {path.stem} --sea {number}{folder}",
            f"dpbench run {suite}",
        ]
    return ["", *textwrap.wrap(about, WIDTH), *(f"  {command}" for command in commands)]


def format_answer_counts(answers: Sequence[Answers]) -> list[str]:
    """Return lines of a table of solvers' right and wrong allocations and solve times."""
    first = answers[0]
    about = (
        f"{first.asked} QPs at the wind limit. Columns: feasible QPs with a correct optimum, "
        "infeasible QPs reported as infeasible, and false claims; p50 and largest solve time. For "
        "the other QPs the solver claimed nothing."
    )
    widths = (20, 12, 13, 14, 10, 10)
    rows: list[tuple[str, ...]] = [
        ("solver", "optimum", "infeasible", "false claims", "p50", "largest")
    ]
    for a in answers:
        counts = f"{a.balanced}/{a.feasible}", f"{a.refused}/{a.infeasible}", str(a.wrong)
        rows.append((a.solver, *counts, format_time(a.p50_ns), format_time(a.max_ns)))
    table = [
        "".join(f"{cell:{'<' if i == 0 else '>'}{widths[i]}}" for i, cell in enumerate(row))
        for row in rows
    ]
    return [*textwrap.wrap(about, WIDTH), "", *table]


def make_json_report(
    capability: Capability,
    vessel: Vessel,
    answers: Sequence[Answers],
    planned: Capability | None = None,
) -> dict[str, Any]:
    """Return the largest winds held and the counts of solvers' right answers, for JSON."""
    every = vessel.thrusters
    report: dict[str, Any] = {
        "vessel": capability.vessel,
        "title": vessel.title,
        "standard": "DNV-ST-0111 (2021) level 1",
        "sides": capability.sides,
        "assumed": list(capability.assumed),
        "cautions": [*caution_on_wash(every), *list_thruster_cautions(every)] if every else [],
        "notation": capability.notation,
        "from_deg": list(FROM_DEG),
        "cases": _list_cases(capability),
        # JSON has no NaN, the one number that differs from itself.
        "solvers": [
            {key: value if value == value else None for key, value in vars(answer).items()}
            for answer in answers
        ],
    }
    if planned is not None:
        report["planned"] = {
            "notation": planned.notation,
            "about": _explain_planned(planned, vessel),
            "cases": _list_cases(planned),
        }
    return report


def _list_cases(capability: Capability) -> list[dict[str, Any]]:
    """Return the winds held and DP capability numbers of each failure case, for JSON."""
    return [
        {
            "name": case,
            "lost": list(capability.lost[case]),
            "wind_mps": [round(at.wind_mps, 3) for at in held],
            "number": [at.number for at in held],
        }
        for case, held in capability.held.items()
    ]

"""Put the page together: one file that needs nothing beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from math import inf
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.suites.study import SMALL_M
from dpbench.analysis.times.solver_tables import (
    level_table,
    pair_reaches,
    tile_table,
    time_table,
    way_of,
)
from dpbench.analysis.verdict.fastest import best_of_each, family_of, known_record
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.configuration import Configuration
from dpbench.bench.record.result_folder import Results, hashes
from dpbench.bench.record.revision import made_by
from dpbench.report.charts import style
from dpbench.report.charts.accuracy import accuracy
from dpbench.report.charts.ladder import ladder
from dpbench.report.charts.matrix import matrix
from dpbench.report.charts.pairs import pairs
from dpbench.report.charts.render import FORMATS, svg, vega
from dpbench.report.charts.strips import COLUMNS as STRIP_COLUMNS
from dpbench.report.charts.strips import strips
from dpbench.report.charts.study import behind_there, design, seas_there
from dpbench.report.glossary import topics as glossary
from dpbench.report.page.answer import Answer, call_text
from dpbench.report.page.cite import software
from dpbench.report.page.facts import Facts, columns_of, number
from dpbench.report.page.places import place_words
from dpbench.report.page.steps import FLAGS
from dpbench.report.page.tables import GROUPS, MOST_ROWS, drawn_tiles, runs_table
from dpbench.report.page.terms import Terms, Word
from dpbench.report.page.topic import Topic
from dpbench.report.page.vendored import script, vendored

ABOUT = (
    "Quadratic-programming solvers in the predictive controller of a dynamically positioned ship"
)
_STATES = ("var(--good)", "var(--near)", "var(--warn)", "var(--late)", "var(--bad)", "var(--none)")
_HUES = [hue for hue in style.FAMILY_COLOURS.values() if hue not in style.STATE_COLOURS]
FILES = {
    "runs.parquet": "one row a run",
    "steps.parquet": "one row a step",
    "capability.parquet": "one row a QP at the edge of what thrusters hold",
    "machine.json": "the machine and the versions",
    "suite.json": "what was asked",
    "tables/runs.csv": "the runs as CSV; README.md beside it explains all tables",
}
VARIABLES = {
    style.INK: "var(--ink)",
    style.SOFT: "var(--soft)",
    style.LINE: "var(--line)",
    style.GRID: "var(--grid)",
    style.PAPER: "var(--paper)",
    style.ACCENT: "var(--accent)",
    **dict(zip(style.STATE_COLOURS, _STATES, strict=True)),
    **dict(zip(style.FILLS, (f"{state[:-1]}-fill)" for state in _STATES), strict=True)),
    **dict(zip(_HUES, (f"var(--hue-{letter})" for letter in "abcdef"), strict=True)),
}
"""Colours of the figures that follow the page into the dark."""


def page_html(
    folder: Path,
    results: Results,
    facts: Facts,
    answer: Answer,
    charts: Mapping[str, Any],
    topics: Sequence[Topic],
    *,
    light: bool = False,
) -> str:
    """The whole page.

    Parameters
    ----------
    folder : where the files are that the page links to.
    topics : sections below those that follow the selection.
    light : without scripts and the steps they show: what a browser shows that runs none.
    """
    pictures = {name: drawn(chart) for name, chart in charts.items() if name in DRAWN}
    lead = next((topic for topic in topics if topic.leads), None)
    others = [topic for topic in topics if topic is not lead]
    places = place_words(facts)
    block = "" if light else facts.block.text(_document(facts, results, answer, charts, places))
    return rendered(
        "page",
        ["\n".join(own(f"scripts/{name}.js") for name in SCRIPTS)],
        title=f"dpbench: {results.suite.get('name', folder.name)}",
        subtitle=str(results.suite.get("title", "")),
        about=ABOUT,
        sections=_sections(facts, charts, others, light),
        answer=answer,
        figures=dict.fromkeys(charts, True) | pictures,
        matrix_said=_matrix_said(facts),
        lead=lead,
        picture=_picture,
        judged=bool(facts.verdicts.of) and not (lead and lead.id == "loops"),
        runs=bool(facts.runs),
        studies=len(facts.studies),
        thinned=0 if light else facts.thinned,
        listed=MOST_ROWS if len(results.runs) > MOST_ROWS else 0,
        run_count=len(results.runs),
        topics=others,
        groups=list(GROUPS),
        files=hashes(folder, FILES),
        holds=FILES,
        kinds=[kind for kind in FORMATS[1:] if any((folder / "figures").glob(f"*.{kind}"))],
        cite=software(results),
        places=places,
        terms=Terms([*WORDS, *glossary()["Solvers and how they are run"]]),
        footer=_footer(results),
        block=block,
    )


def _sections(
    facts: Facts, charts: Mapping[str, Any], topics: Sequence[Topic], light: bool
) -> list[tuple[str, str]]:
    """What the page has, in its order: the id of each section and its name."""
    named = [*_SECTIONS.items(), *((topic.id, topic.short or topic.title) for topic in topics)]
    has = {"answer", *charts, *(topic.id for topic in topics), *(["one"] if facts.runs else [])}
    return [
        (name, title)
        for name, title in named
        if _CHART_OF.get(name, name) in has and not (light and name in LIVE)
    ] + [("data", "Data")]


SCRIPTS = ("common", "selection", "figures", "study", "one", "two", "table", "page")
"""Of the page, in the order they are loaded; the last one starts."""
WORDS = (
    *("demand", "closed loop", "replay", "sample", "step", "round", "p50, p95, p99", "move"),
    *("rate limit", "rate-limit step", "certified optimum", "fallback", "failed step", "interval"),
    *("meets", "borderline", "open", "late", "wrong", "not run"),
)
"""Of the glossary what the page says of any solver, before the words on how they are run."""
_SECTIONS = {
    "answer": "Answer",
    "matrix": "Scenarios",
    "one": "One solver",
    "two": "Two solvers",
    "accuracy": "Accuracy",
}
"""Those that follow the selection."""
_CHART_OF = {"two": "pairs"}
LIVE = ("one", "two")
"""Sections that scripts alone can fill."""
DRAWN = ("ladder", "matrix", "accuracy")
"""Figures that stand on the page before any script has run."""


def charts_of(facts: Facts) -> dict[str, Any]:
    """The figures that this folder has something for."""
    charts: dict[str, Any] = {}
    timed = time_table(facts)
    if len(timed):
        charts["ladder"] = ladder(timed, facts.demand.deadline_ms, facts.demand.p99_ms)
    tiles = drawn_tiles(tile_table(facts)).replace(inf, "inf")  # JSON has no infinity
    if len(tiles):
        charts["matrix"] = matrix(tiles)
        charts["matrix_narrow"] = matrix(tiles, stacked=True)
    nothing = pd.DataFrame(columns=["k", "force", "share"])
    no_steps = pd.DataFrame(columns=list(STRIP_COLUMNS))
    charts["strips"] = strips(no_steps, nothing, facts.demand.error_move)
    replayed = [c for (c, p) in facts.runs if facts.experiments[p].mode == "replay"]
    if replayed:
        charts["strips_replay"] = strips(no_steps, None, facts.demand.error_move)
    if len(set(replayed)) > 1:
        # The axes are named by signals of these names, which the page adds.
        charts["pairs"] = pairs("first", "second")
    if facts.studies:
        charts |= {"design_tiles": design(tiles=True), "design_points": design(tiles=False)}
        charts |= {"behind": behind_there(100 * SMALL_M), "seas": seas_there()}
    points = level_table(facts)
    if len(points):
        charts["accuracy"] = accuracy(points, facts.demand.error_move)
    return charts


def _document(
    facts: Facts,
    results: Results,
    answer: Answer,
    charts: Mapping[str, Any],
    places: Mapping[int, Word],
) -> dict[str, Any]:
    cells, (timed, reach) = list(facts.cells()), pair_reaches(facts)
    verdicts = {v.configuration: v for v in facts.verdicts.all}
    rows = [_configuration(facts, answer, c, verdicts.get(c)) for c in facts.configurations]
    return {
        "solvers": {c.solver: _solver(c.solver) for c in facts.configurations},
        "configurations": columns_of(rows),
        "places": _places(facts, places),
        "cells": columns_of(cells),
        "flags": FLAGS,
        "row_step": style.ROW_STEP,
        "demand": {
            "error_move": facts.demand.error_move,
            "deadline_ms": facts.demand.deadline_ms,
            "p99_ms": facts.demand.p99_ms,
        },
        "charts": _specifications(charts),
        "answer": _opening(facts, results, answer),
        "paired": {"c": timed, "reach": facts.block.log(reach)},
        "studies": facts.study_documents,
        "table": runs_table(facts, results.runs),
    }


def _configuration(
    facts: Facts, answer: Answer, c: Configuration, v: Verdict | None
) -> dict[str, Any]:
    """What the page says of a configuration; of one that is not judged only what it is."""
    times = {} if v is None else {"p50": v.p50_ns, "p99": v.p99_ns, "max": v.algo_max_ns}
    return {
        **way_of(c),
        "outcome": "not judged" if v is None else v.state,
        "why": "" if v is None else answer.why(v),
        **{name: number(times.get(name)) for name in ("p50", "p99", "max")},
        "replay_p99": None if v is None else number(v.replay_p99_ns),
        "raw_p99": None if v is None else number(v.raw_p99_ns),
        "p99_in": "" if v is None else v.p99_on,
        "error": None if v is None else number(v.error_move),
        "failed": None if v is None else v.failed_steps,
        "timed_at": None if v is None else facts.timed_at(v),
        "call": call_text(c),
        **_margin(facts, c),
        **_longest(facts, c),
    }


def _margin(facts: Facts, c: Configuration) -> dict[str, Any]:
    """Return the speed margin of a configuration, and the steps of windows that bound it: the place
    of their loop, the sample and the time [ns]."""
    margin = facts.margin(c)
    if margin is None:
        return {"margin": None, "bounds": []}
    loops = {
        place.name: p
        for p, place in enumerate(facts.experiments)
        if (place.mode, place.units, place.study) == ("closed_loop", "scaled", "")
        and not place.slowdown
    }
    bounds = [
        [loops[step.run.scenario], step.k, number(step.time_ns)]
        for step in (margin.hardest, margin.p99)
        if step.run.window_of and step.run.scenario in loops
    ]
    return {"margin": number(margin.factor), "bounds": bounds}


def _longest(facts: Facts, c: Configuration) -> dict[str, Any]:
    """The largest single timing of a configuration in all its places [ns], and the place."""
    place, run = facts.longest_timing(c) or (None, None)
    if place is None or run is None:
        return {"longest": None, "longest_at": None}
    return {"longest": number(run.raw_max_ns), "longest_at": facts.experiments.index(place)}


def _specifications(charts: Mapping[str, Any]) -> dict[str, Any]:
    """The figures as Vega; the narrow matrix takes its tiles from the wide one."""
    made = {name: specification(chart) for name, chart in charts.items()}
    for data in made.get("matrix_narrow", {}).get("data", ()):
        if "values" in data:
            data["values"] = []
    return made


def _opening(facts: Facts, results: Results, answer: Answer) -> dict[str, Any]:
    """What the page opens with: two configurations, and the step that the suite is about; and of
    each solver the configuration that the figures of the answer show."""
    report = results.suite.get("report", {})
    named = [
        i for i, c in enumerate(facts.configurations) if c.label == report.get("configuration")
    ]
    first, second = (max(0, facts.index(c)) if c else None for c in (answer.first, answer.second))
    of_study, place = facts.opening or (None, None)
    return {
        "first": named[0] if named else first or of_study or 0,
        "second": second,
        "best": {
            v.configuration.solver: facts.index(v.configuration)
            for v in best_of_each(facts.verdicts)
            if facts.index(v.configuration) >= 0
        },
        "place": place,
        "k": report.get("step"),
    }


def _places(facts: Facts, words: Mapping[int, Word]) -> list[dict[str, Any]]:
    """What the page says of each place, from the first run there; the seas of a study whose loops
    the page has no room for are places without one."""
    shows = {p: {"shows": word.meaning} for p, word in words.items()}
    return [
        _place(facts, place, facts.first_runs.get(p)) | shows.get(p, {})
        for p, place in enumerate(facts.experiments)
    ]


def _place(facts: Facts, place: Experiment, run: RunRecord | None) -> dict[str, Any]:
    said: dict[str, Any] = {"label": place.label, "mode": place.mode, "trial": place.units == "si"}
    if place.study:
        said |= {"study": place.study, "point": place.point, "sea": place.replicate}
    if run is None:
        return said
    if not place.study:
        said |= {"source": run.exported_by, "first": run.first_step}
    scenario = facts.scenario(run) if run.scenario else None
    if scenario is not None:
        said["reference"] = [float(x) for x in scenario.reference]
        said["length_m"] = float(scenario.vessel.length_m)
    return said


def _solver(name: str) -> dict[str, str]:
    """What is known of a solver; of one that is not installed here, nothing."""
    known = known_record(name)
    return {"family": family_of(name), "method": known.method if known else ""}


MATRIX = (
    "A tile is what that place alone says of the demand. Wrong: an answer beyond it, or none. "
    "Late: right, but too slow. Borderline: a time as near to its limit as rounds differ. Open: "
    "not all of it was judged. A closed loop counts with the replay of its hardest steps."
)


def _matrix_said(facts: Facts) -> str:
    """What the tiles are; and how many places are left out, where there are too many."""
    tiles = tile_table(facts)
    there, drawn = (t["place"].nunique() if len(t) else 0 for t in (tiles, drawn_tiles(tiles)))
    said = [MATRIX]
    if any(facts.experiments[p].units == "si" for p in facts.judged_experiments):
        said.append(f"In N and N·m is an extra, in no verdict{_wrong_in_si(facts, tiles)}.")
    if there != drawn:
        most = f"The {drawn} of {there} places that miss it most"
        said.append(f"{most}; all are in tables/places.csv.")
    return " ".join(said)


def _wrong_in_si(facts: Facts, tiles: pd.DataFrame) -> str:
    """What who gives a solver such a QP has to know: how many are then wrong at their defaults."""
    unscaled = [str(p) for p in facts.judged_experiments if facts.experiments[p].units == "si"]
    ran = tiles[tiles["place_id"].isin(unscaled) & tiles["state"].ne("not run")]
    asked = ran[ran["settings"] == "default"]
    wrong = asked.loc[asked["state"] == "wrong", "solver"].nunique()
    return f"; {wrong} of {asked['solver'].nunique()} solvers are wrong there: scale the QP" * (
        wrong > 0
    )


def follow(text: str) -> str:
    """A figure whose plain colours are those of the page."""
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, variable)
    return text


def _picture(chart: Any) -> str:
    """The address of a picture within the page, one node there, in the colours of the page."""
    head, rest = follow(svg(chart)).split(">", 1)
    colours = own("templates/page.css").split("* {", 1)[0]
    styled = f"{head}><style>{colours}</style>{rest}"
    return "data:image/svg+xml;base64," + base64.b64encode(styled.encode()).decode()


def _footer(results: Results) -> str:
    numpy = results.machine.get("versions", {}).get("numpy", "")
    started = results.suite.get("started_utc", "")[:10]
    return f"{made_by(results.suite)}, run {started}; numpy {numpy}."


def drawn(chart: Any) -> Markup:
    """A figure as it stands on a page before any script has run."""
    return Markup(follow(svg(chart, titled=False)))


def specification(chart: Any) -> dict[str, Any]:
    """A figure as Vega, in the colours of the page."""
    made: dict[str, Any] = json.loads(follow(json.dumps(vega(chart))))
    return made


def rendered(template: str, scripts: Sequence[str] = (), **shown: Any) -> str:
    """A page out of a template, with the style of all pages, and texts of scripts of its own."""
    texts = [*map(script, vendored()), *scripts]
    shown |= {"css": Markup(own("templates/page.css")), "scripts": list(map(Markup, texts))}
    return environment().get_template(f"{template}.html.j2").render(**shown)


@cache
def environment() -> Environment:
    return Environment(
        loader=PackageLoader("dpbench.report.page", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def own(name: str) -> str:
    return files("dpbench.report.page").joinpath(name).read_text(encoding="utf-8")

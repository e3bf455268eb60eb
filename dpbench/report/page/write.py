"""Put the page together: one file that needs nothing beside it, with the data of its scripts."""

import base64
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from math import isnan
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.times.solver_tables import make_configuration_columns
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.analysis.verdict.verdict import (
    Verdict,
    find_solver_family,
    find_solver_record_or_none,
    list_best_verdict_of_each_solver,
)
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.machine import describe_version
from dpbench.bench.record.result_folder import Results, hash_files
from dpbench.report.charts import style
from dpbench.report.charts.render import FORMATS, compile_vega, render_svg
from dpbench.report.commands_text import describe_how_results_were_made, describe_subject
from dpbench.report.embedded_text import CLOCK_MHZ, CYCLES, describe_deadline, make_calculator_rows
from dpbench.report.formats import format_time
from dpbench.report.page.citations import format_citations
from dpbench.report.page.data import (
    GROUPS,
    MOST_ROWS,
    PageData,
    convert_rows_to_columns,
    convert_to_json_number,
)
from dpbench.report.page.live import SECTIONS, select_static_charts
from dpbench.report.page.recommendation import Recommendation, format_python_call
from dpbench.report.page.section import Topic
from dpbench.report.page.terms import GlossaryEntry, Terms, describe_experiments, find_entry
from dpbench.report.page.vendored import list_vendored_scripts, read_script
from dpbench.report.verdict.findings_text import name_experiment
from dpbench.report.verdict.verdict_text import (
    describe_hardest_wait,
    describe_lateness,
    format_p99_interval,
)
from dpbench.report.words import topics as glossary


def make_page_document(
    data: PageData,
    results: Results,
    recommendation: Recommendation,
    words: Mapping[int, GlossaryEntry],
) -> dict[str, Any]:
    """Return the JSON data of the report page, all but its charts, for its scripts.

    Arrays of numbers go into `data.block`; words : descriptions of experiments, by index.
    """
    cells, is_time_judged = list(data.cells()), data.requirements.judges_step_times
    verdicts = {v.configuration: v for v in data.verdicts.all_verdicts}
    rows = [
        _describe_configuration(data, recommendation, c, verdicts.get(c))
        for c in data.configurations
    ]
    document: dict[str, Any] = {
        "solvers": {
            name: {"family": find_solver_family(name), "method": known.method if known else ""}
            for name in dict.fromkeys(c.solver for c in data.configurations)
            for known in [find_solver_record_or_none(name)]
        },
        "configurations": convert_rows_to_columns(rows),
        "experiments": [
            _describe_experiment(data, experiment, data.first_run_by_experiment.get(p))
            | ({"shows": words[p].meaning} if p in words else {})
            for p, experiment in enumerate(data.experiments)
        ],
        "cells": convert_rows_to_columns(cells),
        "flags": [vars(find_entry(term)) for term in FLAG_TERMS],
        "row_step": style.ROW_STEP,
        "requirements": {
            "error_move": data.requirements.error_move,
            "deadline_ms": data.requirements.deadline_ms if is_time_judged else None,
            "p99_ms": data.requirements.p99_ms if is_time_judged else None,
        },
        "answer": _select_at_opening(data, results, recommendation),
    }
    for section in SECTIONS:
        document |= section.data(data, results)
    return document


def _describe_configuration(
    data: PageData, recommendation: Recommendation, c: Configuration, v: Verdict | None
) -> dict[str, Any]:
    """Return the facts of a configuration that the page's script needs."""
    times = {} if v is None else {"p50": v.p50_ns, "p99": v.p99_ns, "max": v.longest_ns}
    return {
        **make_configuration_columns(c),
        "verdict": "not judged" if v is None else v.state,
        "why": "" if v is None else recommendation.why(v).replace("**", ""),
        "late": "" if v is None else describe_lateness(v),
        **{name: convert_to_json_number(times.get(name)) for name in ("p50", "p99", "max")},
        "p50_in": "" if v is None else f"the replay of `{v.timed_on}`",
        "p99_in": ""
        if v is None or v.p99_run is None
        else name_experiment(v.p99_run) + format_p99_interval(v.p99_interval),
        "error": None if v is None else convert_to_json_number(v.error_move),
        "failed": None if v is None else v.failed_steps,
        "timed_experiment_index": None if v is None else data.find_timed_experiment_index(v),
        "call": format_python_call(c),
        **_describe_margin(data, c, v),
        "longest_in_windows": [list(step) for step in data.longest_window_steps.get(c, ())],
        "max_wait": describe_hardest_wait(data.records, None if v is None else v.longest_run),
        "max_in": "" if v is None or v.longest_run is None else name_experiment(v.longest_run),
    }


def _describe_margin(data: PageData, c: Configuration, v: Verdict | None) -> dict[str, Any]:
    """Return how much slower a computer may be for a configuration, and which time limits it."""
    margin = data.get_speed_margin(c)
    if margin is None:
        return {"margin": None, "limited_by": "", "p99_run_id": ""}
    requirements, longest = data.requirements, format_time(margin.longest_ns)
    if margin.deadline < margin.p99_limit:
        limited_by = f"longest step of {longest} (deadline {requirements.deadline_ms:g} ms)"
    elif v is None or isnan(v.p99_ns):
        limit = f"p99 limit {requirements.p99_ms:g} ms, as too few steps give a p99"
        limited_by = f"longest step of {longest} ({limit})"
    else:
        p99 = format_time(margin.limiting_p99_ns)
        limited_by = f"limiting p99 of {p99} (limit {requirements.p99_ms:g} ms)"
    return {
        "margin": convert_to_json_number(margin.allowed_slowness_factor),
        "limited_by": limited_by,
        "p99_run_id": margin.p99.run.run_id,
    }


def _select_at_opening(
    data: PageData, results: Results, recommendation: Recommendation
) -> dict[str, Any]:
    """Return the configurations and the scenario or replay that the page selects as it opens."""
    report = results.suite.get("report", {})
    named = [i for i, c in enumerate(data.configurations) if c.label == report.get("configuration")]
    first, second = (
        max(0, data.find_index(c)) if c else None
        for c in (recommendation.first, recommendation.second)
    )
    of_study, experiment = data.opening or (None, None)
    return {
        "first": named[0] if named else first or of_study or 0,
        "second": second,
        "best": {
            v.configuration.solver: data.find_index(v.configuration)
            for v in list_best_verdict_of_each_solver(data.verdicts)
            if data.find_index(v.configuration) >= 0
        },
        "experiment": experiment,
        "k": report.get("step"),
    }


def _describe_experiment(
    data: PageData, experiment: Experiment, run: RunRecord | None
) -> dict[str, Any]:
    """Return label, mode and reference of a scenario, replay or study run for the page's script."""
    wording: dict[str, Any] = {
        "label": experiment.label,
        "mode": experiment.mode,
        "trial": experiment.units == "si",
    }
    if experiment.study:
        wording |= {
            "study": experiment.study,
            "point": experiment.point,
            "sea": experiment.replicate,
        }
    if run is None:
        return wording
    if run.is_of_own_plant:
        wording["own_plant"] = True
    if not experiment.study:
        wording |= {"source": run.export_argument, "first": run.first_step}
    scenario = data.build_scenario_of_run(run) if run.scenario else None
    if scenario is not None:
        wording["reference"] = [float(x) for x in scenario.reference]
        wording["length_m"] = float(scenario.vessel.length_m)
    return wording


_STATES = ("var(--good)", "var(--near)", "var(--warn)", "var(--late)", "var(--bad)", "var(--none)")
_HUES = [hue for hue in style.FAMILY_COLOURS.values() if hue not in style.STATE_COLOURS]
FILES = {
    "runs.parquet": "one row per run",
    "steps.parquet": "one row per step and round; may be missing from published copies",
    "embedded.parquet": "one row per step solved by C code for an embedded core in an emulator",
    "capability.parquet": "one row per QP at the edge of the capability plot",
    "machine.json": "description of the machine and versions of its software",
    "suite.json": "the suite that was run, its start and duration, and the revision of dpbench",
    "suite.toml": "the suite alone, to run it again: `dpbench run suite.toml`",
    "tables/runs.csv": "the runs as CSV; tables/README.md describes all tables",
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


def make_page_html(
    folder: Path,
    results: Results,
    data: PageData,
    recommendation: Recommendation,
    charts: Mapping[str, Mapping[str, Any]],
    topics: Sequence[Topic],
    *,
    light: bool = False,
) -> str:
    """Return the report page as HTML, in one file that needs no other.

    folder : where the files are that the page links to.
    charts : of `draw_section_charts`; topics : sections below those that follow the selection.
    light : without scripts and the steps they show.
    """
    shown = [
        section
        for section in SECTIONS
        if (section.always or charts.get(section.id)) and not (section.live and light)
    ]
    figures = {
        name: chart for section in shown for name, chart in charts.get(section.id, {}).items()
    }
    lead = next((topic for topic in topics if topic.leads), None)
    *above, last = (section for section in shown if not section.in_topic)
    experiments = describe_experiments(data)
    numpy = results.machine.get("versions", {}).get("numpy", "")
    started = results.suite.get("started_utc", "")[:10]
    block = ""
    if not light:
        document = make_page_document(data, results, recommendation, experiments)
        block = data.block.compress_to_base64(
            document | {"charts": _compile_vega_of_charts(figures)}
        )
    return render_page(
        "page",
        ["\n".join(read_page_file(f"scripts/{name}.js") for name in SCRIPTS)],
        title=f"dpbench: {results.suite.get('name', folder.name)}",
        about=describe_subject(data.records, results.suite),
        sections=[*above, *(topic for topic in topics if topic is not lead), last],
        parts={section.id: section for section in shown if section.in_topic},
        texts={section.id: section.text(data) for section in shown},
        folded_texts={section.id: section.folded_text(data) for section in shown},
        answer=recommendation,
        figures={
            name: render_figure_markup(chart)
            for name, chart in select_static_charts(charts).items()
        },
        lead=lead,
        core_times=make_calculator_rows(data.counts, data.requirements),
        cycles=f"{CYCLES:g}",
        clock_mhz=f"{CLOCK_MHZ:g}",
        deadline=describe_deadline(data.requirements),
        picture=_encode_picture_as_url,
        judged=bool(data.verdicts.of) and not (lead and lead.id == "loops"),
        runs=bool(data.runs),
        studies=len(data.studies),
        thinned=0 if light else data.thinned_count,
        listed=MOST_ROWS if len(results.runs) > MOST_ROWS else 0,
        run_count=len(results.runs),
        groups=list(GROUPS),
        files=hash_files(folder, FILES),
        holds=FILES,
        kinds=[kind for kind in FORMATS[1:] if any((folder / "figures").glob(f"*.{kind}"))],
        cite=format_citations(results),
        made=describe_how_results_were_made(data.records, results.suite, results.machine),
        experiments=experiments,
        terms=Terms([*WORDS, *glossary()["Solvers and configurations"]]),
        footer=f"{describe_version(results.suite)}, run {started}; NumPy {numpy}.",
        block=block,
    )


SCRIPTS = ("common", "selection", "figures", *(section.id for section in SECTIONS), "page")
"""Scripts of the page in the order of loading; the last one starts the page."""
FLAG_TERMS = ("failed step", "late", "fallback", "clipped")
"""Terms of the glossary for a step's flags, `FLAGS` but claimed and true."""
WORDS = (
    *(
        "requirements",
        "closed loop",
        "replay",
        "sample time",
        "step",
        "sequence",
        "window",
        "round",
        "p50, p95, p99",
        "move",
    ),
    *("rate limit", "maximum increment", "certified optimum", "fallback", "failed step", "stall"),
    "clipped",
    *("interval", "pass", "borderline", "inconclusive", "late", "fail", "not run"),
)
"""Terms of the glossary on the page, before those on how solvers are run."""


def use_page_colours(text: str) -> str:
    """Return a chart's text with CSS variables of the page for its fixed colours."""
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, variable)
    return text


def _encode_picture_as_url(chart: Any) -> str:
    """Return a chart as a `data:` URL of an SVG picture in the colours of the page."""
    head, rest = use_page_colours(render_svg(chart)).split(">", 1)
    colours = read_page_file("templates/page.css").split("* {", 1)[0]
    styled = f"{head}><style>{colours}</style>{rest}"
    return "data:image/svg+xml;base64," + base64.b64encode(styled.encode()).decode()


def _compile_vega_of_charts(charts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Vega specifications of charts by name; shared data once."""
    made = {name: compile_vega_in_page_colours(chart) for name, chart in charts.items()}
    for data in made.get("matrix_narrow", {}).get("data", ()):
        if "values" in data:
            data["values"] = []
    return made


def render_figure_markup(chart: Any) -> Markup:
    """Return a chart as SVG in the colours of the page."""
    return Markup(use_page_colours(render_svg(chart, titled=False)))


def compile_vega_in_page_colours(chart: Any) -> dict[str, Any]:
    """Return a chart as a Vega specification in the colours of the page."""
    made: dict[str, Any] = json.loads(use_page_colours(json.dumps(compile_vega(chart))))
    return made


def render_page(template: str, scripts: Sequence[str] = (), **shown: Any) -> str:
    """Return an HTML page made of a named template, with the common style and scripts."""
    texts = [*map(read_script, list_vendored_scripts()), *scripts]
    shown |= {
        "css": Markup(read_page_file("templates/page.css")),
        "scripts": list(map(Markup, texts)),
    }
    return make_template_environment().get_template(f"{template}.html.j2").render(**shown)


@cache
def make_template_environment() -> Environment:
    """Return the Jinja environment that loads the page's HTML templates."""
    return Environment(
        loader=PackageLoader("dpbench.report.page", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def read_page_file(name: str) -> str:
    """Return the text of a template or script of the page."""
    return files("dpbench.report.page").joinpath(name).read_text(encoding="utf-8")

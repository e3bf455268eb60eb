"""Put the page together: one file that needs nothing beside it."""

import base64
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dpbench.bench.record.machine import describe_revisions, describe_version
from dpbench.bench.record.result_folder import Results, hash_files
from dpbench.report.charts import style
from dpbench.report.charts.render import FORMATS, compile_vega, render_svg
from dpbench.report.embedded_text import CLOCK_MHZ, CYCLES, NOTE, make_calculator_rows
from dpbench.report.page.data import PageData
from dpbench.report.page.document import make_page_document
from dpbench.report.page.live import SECTIONS, select_static_charts
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.section import Topic
from dpbench.report.page.tables import GROUPS, MOST_ROWS
from dpbench.report.page.terms import Terms, describe_experiments
from dpbench.report.page.vendored import list_vendored_scripts, read_script
from dpbench.report.words import topics as glossary

ABOUT = (
    "Quadratic-programming solvers in the predictive controller of a dynamically positioned ship"
)
_STATES = ("var(--good)", "var(--near)", "var(--warn)", "var(--late)", "var(--bad)", "var(--none)")
_HUES = [hue for hue in style.FAMILY_COLOURS.values() if hue not in style.STATE_COLOURS]
FILES = {
    "runs.parquet": "one row a run",
    "steps.parquet": "one row a step; a published copy may lack it: the same run writes it again",
    "embedded.parquet": "one row a step of a solver's C on an embedded core",
    "capability.parquet": "one row a QP at the edge of what thrusters hold",
    "machine.json": "the machine and the versions",
    "suite.json": "the suite that was requested",
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
        subtitle=str(results.suite.get("title", "")),
        about=ABOUT,
        sections=[*above, *(topic for topic in topics if topic is not lead), last],
        parts={section.id: section for section in shown if section.in_topic},
        texts={section.id: section.text(data) for section in shown},
        answer=recommendation,
        figures={
            name: render_figure_markup(chart)
            for name, chart in select_static_charts(charts).items()
        },
        lead=lead,
        core_times=make_calculator_rows(data.counts, data.requirements),
        counts_note=NOTE,
        cycles=f"{CYCLES:g}",
        clock_mhz=f"{CLOCK_MHZ:g}",
        deadline_ms=f"{data.requirements.deadline_ms:g}",
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
        cite=format_software_citation(results),
        experiments=experiments,
        terms=Terms([*WORDS, *glossary()["Solvers and how they are run"]]),
        footer=f"{describe_version(results.suite)}, run {started}; numpy {numpy}.",
        block=block,
    )


SCRIPTS = ("common", "selection", "figures", *(section.id for section in SECTIONS), "page")
"""Scripts of the page in the order of loading; the last one starts the page."""
WORDS = (
    *("requirements", "closed loop", "replay", "sample", "step", "round", "p50, p95, p99", "move"),
    *("rate limit", "rate-limit step", "certified optimum", "fallback", "failed step", "interval"),
    *("pass", "borderline", "inconclusive", "late", "fail", "not run"),
)
"""Terms of the glossary on the page, before those on how solvers are run."""


def use_page_colours(text: str) -> str:
    """Replace the fixed colours in a chart's text by CSS variables of the page."""
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, variable)
    return text


def _encode_picture_as_url(chart: Any) -> str:
    """Encode a chart as a `data:` URL of an SVG picture in the colours of the page."""
    head, rest = use_page_colours(render_svg(chart)).split(">", 1)
    colours = read_page_file("templates/page.css").split("* {", 1)[0]
    styled = f"{head}><style>{colours}</style>{rest}"
    return "data:image/svg+xml;base64," + base64.b64encode(styled.encode()).decode()


def format_software_citation(results: Results) -> str:
    """Return a BibTeX entry of the dpbench version that made the results."""
    version = f"Software, version {results.suite.get('harness_version', '')}"
    return f"""@misc{{dpbench,
  author = {{{{The dpbench authors}}}},
  title = {{dpbench: benchmark of QP solvers inside the model predictive controller of a dynamically
    positioned ship}},
  year = {{{results.suite.get("started_utc", "")[:4]}}},
  howpublished = {{{", ".join(filter(None, (version, describe_revisions(results.suite))))}}},
}}"""


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
    """Render an HTML page from a named template, with the common style and scripts."""
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

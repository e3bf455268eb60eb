"""Every kind of suite has a page of its own: what it has is shown, what nobody asked for is not."""

import copy
import json
import re
from collections.abc import Callable
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.record.result_folder import load_results
from dpbench.cli.main import main
from dpbench.qp.random_sequence import RandomRecipe
from dpbench.report.report import Report
from dpbench.report.write import write_report, write_report_with_summary
from dpbench.solvers.calibration import CALIBRATION, WAITS_NS
from tests.report.page.test_html import checked

TITLES = {
    "horizon": "Longer horizons",
    "slowdown": "Slower computers",
    "anytime": "Solves stopped early",
    "random": "Random QPs",
    "consequence": "Consequence analysis",
    "formulations": "Formulations",
    "routes": "Routes",
    "paper": "The paper",
    "trust": "Measurement quality",
}
TIMED = {"replay_s": 2.0, "involuntary_switches": 4, "steal_s": 0.0}


def _pair_of_replays(records: Any) -> None:
    records.replay("daqp", steps=30)
    records.replay("osqp", steps=30, median_us=80.0)


def _pair_of_loops(records: Any) -> None:
    records.loop("daqp", "calm", steps=40)
    records.loop("osqp", "calm", steps=40, error=0.4)


def _paper(records: Any) -> None:
    records.loop("daqp", steps=1000)
    records.loop("unconstrained_clipped", steps=1000, formulation="none", error=1.0)


def _random(records: Any) -> None:
    recipe = RandomRecipe("plain", 4, 6, 1)
    source = {"kind": "random", "name": recipe.sequence_name, "recipe": asdict(recipe)}
    records.replay("daqp", steps=6, scenario="", cell=json.dumps({"source": source}))


def _consequence(records: Any) -> None:
    files = records.scenario("thrusters").files
    for group in ("board A", "board B"):
        name = f"thrusters[0:30], {group} lost"
        source = {"kind": "consequence", "name": name, "group": group}
        cell = json.dumps({"scenario": files, "source": source})
        records.replay("daqp", name, steps=30, cell=cell)


def _slow(records: Any) -> None:
    for slowdown in (1.0, 100.0):
        figures = {"closed_loop_cost": 101.0, "exact_cost": 100.0, "deadline_s": 0.3}
        late = {"latency_max_ns": 5e4 * slowdown, "deadline_misses": 2}
        records.loop("daqp", steps=30, slowdown=slowdown, **figures, **late)


def _stopped(records: Any) -> None:
    records.suite["closed_loop"] = [{"iteration_limits": [1, 50]}]
    for limit in (1, 50):
        options = {"settings": f"max_iter={limit}", "options": json.dumps({"max_iter": limit})}
        records.loop("osqp", steps=30, exact_cost=100.0, unconverged=30, **options)


def _horizon(records: Any) -> None:
    for N_p, N_c in ((30, 5), (60, 10), (100, 20)):
        files = copy.deepcopy(records.scenario("paper").files)
        own = {"prediction_horizon": N_p, "control_horizon": N_c}
        files["scenario"]["controller"].update(own)
        files["name"] = name = f"paper-{N_p}-{N_c}"
        columns = {"N_p": N_p, "N_c": N_c, "n": 3 * N_c, "m": 3 * N_c, "scenario": name}
        cell = json.dumps({"scenario": files, "first": 0})
        records._scenarios[name] = records.scenario("paper")
        records.replay("daqp", name, steps=40, median_us=4.0 * N_c, **columns, cell=cell)


def _calibration(records: Any) -> None:
    for name in CALIBRATION:
        median_us = WAITS_NS.get(name, 0) / 1e3 + 0.3
        records.replay(name, steps=30, median_us=median_us, route="native", **TIMED)


def _recorded(records: Any) -> None:
    records._scenarios["robot"] = records.scenario("paper")
    for solver in ("daqp", "osqp"):
        records.replay(solver, "robot", steps=30, scenario="", cell=json.dumps({}))


def _formulations(records: Any) -> None:
    for form in ({}, {"formulation": "sparse"}):
        records.replay("osqp", steps=30, **form)


def _routes(records: Any, *solvers: str) -> None:
    for solver in solvers or ("daqp",):
        records.replay(solver, steps=200)
        records.replay(solver, steps=200, route="native", median_us=10.0)
        records.replay(solver, steps=200, route="native", policy="warm", median_us=5.0)


def _levels(records: Any) -> None:
    for settings, error in (("default", 0.3), ("mid", 1e-4), ("high", 1e-6)):
        records.replay("osqp", steps=30, settings=settings, error=error)


def _searched(records: Any) -> None:
    _pair_of_replays(records)
    records.suite["report"] = {"step": 7, "configuration": "osqp (qpsolvers fresh)"}


KINDS: dict[str, tuple[Callable[[Any], None], str, set[str]]] = {
    "replays": (_pair_of_replays, "race", set()),
    "loops": (_pair_of_loops, "loops", set()),
    "paper": (_paper, "paper", set()),
    "timed": (lambda records: records.replay("daqp", steps=30, **TIMED), "", {"trust"}),
    "random": (_random, "random", set()),
    "consequence": (_consequence, "consequence", set()),
    "slow computers": (_slow, "slowdown", set()),
    "stopped early": (_stopped, "anytime", set()),
    "horizons": (_horizon, "horizon", set()),
    "calibration": (_calibration, "trust", set()),
    "recorded": (_recorded, "race", set()),
    "formulations": (_formulations, "formulations", set()),
    "routes": (_routes, "routes", set()),
    "routes of two solvers": (lambda records: _routes(records, "daqp", "osqp"), "routes", set()),
    "settings": (_levels, "levels", {"settings"}),
    "worst case": (_searched, "worst-case", set()),
}
"""Topics by kind of suite: the one that is its question, and the others."""


def _words(html: str) -> str:
    """Return the words on the page before a script runs."""
    body = re.sub(r"<(script|style|svg|details)\b.*?</\1>", " ", html, flags=re.S)
    body = re.sub(r"</?code>", "", body)
    body = re.sub(r'<a class="term"[^>]*>(.*?)</a>', r"\1", body)
    return " ".join(re.sub(r"<[^>]+>", " ", body).split())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_suite_shows_what_it_has_alone(records: Any, tmp_path: Path, kind: str) -> None:
    fill, lead, topics = KINDS[kind]
    fill(records)
    out = records.write(tmp_path / "out")
    page, lines = write_report_with_summary(out)
    html, text = page.read_text("utf-8"), (out / "report.md").read_text("utf-8")
    found = checked(html)
    shown = _words(html)
    for topic, title in TITLES.items():
        if topic == lead:
            continue
        assert (topic in found.ids) == (topic in topics), topic
        assert (f"{title}" in shown) == (topic in topics), title
        assert (f"\n{title}" in text) == (topic in topics), title
    answer = _words(html.split('<section id="answer">')[1].split("</section>")[0])
    assert "issing" not in shown and "issing" not in text
    assert all(lines) and lines
    report = Report.from_results(load_results(out))
    assert {topic.id for topic in report.topics} == topics | ({lead} - {""})
    first = report.topics[0] if lead else None
    opening = first.lines[0] if first else report.recommendation.verdict
    ship = report.recommendation.ship
    shown_first = " ".join(
        escape(line.replace("`", "")) for line in (ship.headline, opening) if line
    )
    assert answer.startswith(f"Summary {shown_first}") and opening in text and ship.text in text
    assert (first is None) == (lead == "") and (first is None or first.leads)
    drawn = {path.stem for path in (out / "figures").iterdir()}
    assert drawn == set(report.figures)
    tables = {path.stem for path in (out / "tables").iterdir()}
    # The ratios of two settings are rows of the table of all pairs.
    files = {"settings": "paired_ratios"}
    assert {files.get(topic.id, topic.id) for topic in report.topics if topic.tables} <= tables


@pytest.mark.parametrize("kind", ["random", "consequence", "slow computers", "calibration"])
def test_without_a_solver_on_a_ship_no_requirements_are_named(records: Any, kind: str) -> None:
    KINDS[kind][0](records)
    report = Report.from_results(records.results())
    answer, lead = report.recommendation, report.topics[0]
    starts = {
        "random": "0 false claims on ",
        "consequence": (
            "In thrusters[0:30] (steps 0 to 29, wind 17.1 m/s from 40°) the loss of board A or of "
            "board B can be held throughout"
        ),
        "slow computers": (
            "Largest slowdown survived in paper: daqp (qpsolvers fresh) at least × 100 (the "
            "largest run)"
        ),
        "calibration": "Waits of known length were measured to within ",
    }
    assert lead.leads and lead.lines[0].startswith(starts[kind])
    assert (answer.sentence, answer.requirements, answer.snippets, answer.chips) == ("", "", (), ())


def _all_failed(records: Any, **columns: Any) -> None:
    for solver in ("daqp", "scs"):
        records.loop(solver, **columns)
        records.replay(solver, **columns)


def _add_odd_names(records: Any) -> None:
    records.loop('a<b>&"c|d', outcome_detail="<script>", outcome="timed_out", done=5)


def _single_step(records: Any) -> None:
    records.loop("daqp", steps=1)
    records.replay("daqp", steps=1, rounds=1)


CRASHED = {"done": 0, "outcome": "crashed", "outcome_detail": "signal 11"}
NO_SOLVER = "No solver was run, so there is nothing to judge."
PARTIAL: list[tuple[Callable[[Any], Any], str]] = [
    (lambda _: None, NO_SOLVER),
    (
        lambda records: records.refused("qpax", "not installed"),
        "Nothing is recommended, because every run was refused (not installed).",
    ),
    (_single_step, "Use daqp (qpsolvers fresh, default)"),
    (lambda records: _all_failed(records, **CRASHED), "Nothing is recommended"),
    (
        lambda records: _all_failed(records, error=float("inf"), failed=120),
        "Nothing is recommended: no solver passes",
    ),
    (
        lambda records: records.loop("unconstrained_clipped", formulation="none", error=1.0),
        NO_SOLVER,
    ),
    (
        lambda records: records.loop("daqp", units="si", settings="high"),
        "Accurate on every step of 1 closed loop: daqp (qpsolvers fresh, high, in SI units).",
    ),
    (_add_odd_names, "No configuration is accurate on every step of 1 closed loop;"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("fill", "says"), PARTIAL)
def test_partial_results_still_make_a_report(
    records: Any, tmp_path: Path, fill: Callable[[Any], None], says: str
) -> None:
    fill(records)
    out = records.write(tmp_path / "out")
    html = write_report(out).read_text(encoding="utf-8")
    checked(html)
    assert says in (out / "report.md").read_text(encoding="utf-8").replace("`", "")
    assert says in _words(html)


@pytest.mark.slow
def test_odd_names_are_escaped_and_rewritten_the_same(records: Any, tmp_path: Path) -> None:
    _add_odd_names(records)
    records.replay("daqp", steps=30)
    out = records.write(tmp_path / "out")
    html = write_report(out).read_text(encoding="utf-8")
    assert "<b>&" not in html and "a&lt;b&gt;" in html
    rows = [x for x in (out / "report.md").read_text("utf-8").splitlines() if x.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    write_report(out)
    assert {path: path.read_bytes() for path in before} == before


def test_every_figure_is_written_in_every_format_asked_for(written: Any) -> None:
    names = set(written.report.figures)
    assert names >= {"ladder", "matrix", "accuracy", "paper-errors"}
    found = {path.name for path in (written.folder / "figures").iterdir()}
    assert found == {f"{name}.{kind}" for name in names for kind in ("svg", "pdf")}
    for name in names:
        drawn = (written.folder / "figures" / f"{name}.svg").read_text("utf-8")
        assert "<text" in drawn
        pdf = (written.folder / "figures" / f"{name}.pdf").read_bytes()
        assert pdf.startswith(b"%PDF-")


def test_every_figure_is_a_valid_specification(written: Any) -> None:
    report = written.report
    live = {n: chart for own in report.charts.values() for n, chart in own.items()}
    for name, chart in {**live, **report.figures}.items():
        assert chart.to_dict(validate=True)["$schema"].startswith("https://vega"), name


@pytest.mark.parametrize(
    ("options", "output"),
    [
        ("--figures gif", "--figures: found 'gif'; allowed: svg, pdf, png"),
        (
            "--baseline nope",
            "--baseline: found 'nope'; allowed: a solver that was run: daqp",
        ),
    ],
)
def test_bad_options(records: Any, tmp_path: Path, capsys: Any, options: str, output: str) -> None:
    records.loop("daqp", steps=20)
    out = records.write(tmp_path / "out")
    assert main(["report", str(out), *options.split()]) == 2
    assert capsys.readouterr().err == f"dpbench: {output}\n"
    assert not (out / "report.html").exists() and not (out / "report.md").exists()

"""The statement: what holds, with hashes; none where nothing does."""

import hashlib
import io
import json
import re
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
import vl_convert as vlc

from dpbench.cli.main import main
from dpbench.report.documents import statement
from dpbench.report.documents.pdf_pages import split_into_pages
from dpbench.report.documents.statement import (
    HEIGHT,
    MARGIN,
    WIDTH,
    describe_thrusters,
    make_statement_svg,
)
from dpbench.report.formats import format_error, format_time
from dpbench.report.page.recommendation import list_speed_margin_sentences
from dpbench.report.report import Report
from dpbench.report.ship.controller_text import describe_controllers, list_model_gaps
from dpbench.report.ship.open_losses import OpenLosses
from dpbench.report.ship.ship_text import BANNER
from dpbench.report.verdict.verdict_text import format_settings_with_other_states
from dpbench.scenario.own_thrusters import (
    describe_own_wind_areas,
    list_assumptions_on_vessel,
    split_source,
)
from dpbench.scenario.scenario import load_scenario, load_vessel
from dpbench.ship.thrusters import Screw, ThrusterSet
from dpbench.ship.vessel import HullDrag

HEADING = "Solver for the QPs of these runs only"


def _good(records: Any, tmp_path: Path) -> Path:
    records.loop("daqp")
    records.replay("daqp", spread=0.1)
    out: Path = records.write(tmp_path / "out")
    return out


@pytest.fixture(scope="module")
def drawn(written: Any) -> str:
    report = written.report
    return make_statement_svg(written.folder, report.results, report.data)


def _texts(svg: str) -> list[ElementTree.Element]:
    root = ElementTree.fromstring(svg)
    return [element for element in root.iter() if element.tag.endswith("text")]


@pytest.mark.slow
def test_pdf_and_svg_are_written(records: Any, tmp_path: Path, capsys: Any) -> None:
    out = _good(records, tmp_path)
    for kind in ("pdf", "svg"):
        assert main(["report", str(out), "--statement", str(tmp_path / f"a.{kind}")]) == 0
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF-")
    assert ElementTree.parse(tmp_path / "a.svg").getroot().tag.endswith("svg")
    capsys.readouterr()
    assert main(["report", str(out), "--statement", str(tmp_path / "a.doc")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("allowed: a file name that ends in .pdf or .svg")


@pytest.mark.parametrize(
    "missing",
    ["loop", *(pytest.param(part, marks=pytest.mark.slow) for part in ("replay", "right", "all"))],
)
def test_no_recommendation_no_statement(
    records: Any, tmp_path: Path, capsys: Any, missing: str
) -> None:
    """One line, exit code 2 and no file: what is open or missed cannot be handed over."""
    if missing not in ("loop", "all"):
        records.loop("daqp", error=0.4 if missing == "right" else 1e-9)
    if missing not in ("replay", "all"):
        records.replay("daqp")
    out = records.write(tmp_path / "out")
    assert main(["report", str(out), "--statement", str(tmp_path / "a.pdf")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no deployable configuration with the overall verdict pass" in line
    assert not (tmp_path / "a.pdf").exists() and not (out / "report.html").exists()


def test_it_has_the_verdict_where_it_is_valid_and_what_is_not(drawn: str, written: Any) -> None:
    text = " ".join("".join(element.itertext()) for element in _texts(drawn))
    facts, first = written.report.data, written.report.recommendation.first
    (verdict,) = (v for v in facts.verdicts.all_verdicts if v.configuration == first)
    assert "Solver daqp 1.0, route qpsolvers, policy fresh, settings default" in text
    for figure in (
        format_error(verdict.error_move),
        format_time(verdict.p99_ns),
        format_time(verdict.longest_ns),
        list_speed_margin_sentences(facts, verdict)[0],
        *("Synthetic CPU", "0123456789ab", "does not cover other vessels"),
        *("State during timing: quiet", "DNV-ST-0111", "IMCA M 220"),
        "This statement replaces none of these",
        "power limits (3.12), rudders (3.10), and operator-defined zones",
        "calculation of DP capability level 2 nor the time-domain simulation of level 3",
        "Conditions of ",
        "sensors, estimators, lags, delays and mismatches other than those stated above",
        "Compared, with the limiting p99 of all replays and windows: daqp 1.0 (default) pass",
        *("ecos 1.0 fail", "Author ___", "Date ___", "Signature ___"),
        "Conditions that no closed loop contains: a problem without a feasible point, a loss of ",
    ):
        assert figure in text, figure
    (scenario,) = {run.scenario for run in facts.records.runs if run.scenario == "paper"}
    files = facts.records.build_scenario(scenario).files
    stored = json.dumps(files["scenario"], sort_keys=True, ensure_ascii=False).encode()
    digest = hashlib.sha256(stored).hexdigest()
    assert f"scenario paper (stored document)  SHA-256 {digest}" in drawn
    assert f"vessel {files['vessel_name']} (stored document)  SHA-256 " in drawn
    for name in ("runs.parquet", "steps.parquet", "machine.json", "suite.json"):
        digest = hashlib.sha256((written.folder / name).read_bytes()).hexdigest()
        assert f"{name}  SHA-256 {digest}" in drawn and digest in written.html
    for p, experiment in enumerate(facts.experiments):
        if facts.get_state_in_experiment(facts.find_index(first), p) == "pass":
            assert experiment.label in text


def test_a_verdict_names_its_settings_where_others_have_another() -> None:
    """The best of two settings is late, the other one fails; a pass names its settings alone."""

    def judge(settings: str, state: str, loops: int = 1) -> Any:
        configuration = SimpleNamespace(solver="osqp", settings=settings)
        return SimpleNamespace(configuration=configuration, state=state, loops=loops, replays=1)

    best = judge("high", "late")
    for others, expected in (
        ([judge("default", "fail")], " (high; with default: fail)"),
        ([judge("default", "late")], ""),
        # A call mode that was not run in closed loop has no verdict to compare.
        ([judge("default", "late"), judge("default", "inconclusive", loops=0)], ""),
        ([], ""),
    ):
        verdicts: Any = SimpleNamespace(of={"osqp": [*others, best]})
        assert format_settings_with_other_states(verdicts, best) == expected
    verdicts = SimpleNamespace(of={"osqp": [best, judge("low", "pass")]})
    assert format_settings_with_other_states(verdicts, verdicts.of["osqp"][1]) == " (low)"


def test_a_sector_is_listed_with_its_thruster() -> None:
    """Both what it pushes towards and what is barred; without power and sector the name alone."""
    azimuth: dict[str, Any] = {
        "name": "azimuth",
        "power_kW": 1200.0,
        "group": "A",
        "sector_deg": [-30.0, 60.0],
    }
    said = describe_thrusters([azimuth, {"name": "bow", "group": "A", "sector_deg": None}])
    sector = "pushes 330° to 60° (race 150° to 240°), barred 60° to 330° (race 240° to 150°)"
    assert said == f"A: azimuth (1200 kW, {sector}), bow"
    planned = azimuth | {"sector_deg": [240.0, 60.0], "controller_sector_deg": [240.0, 60.0]}
    assert describe_thrusters([planned]).endswith(", controllers plan with 240° to 60°)")
    bow = {"name": "bow", "kind": "tunnel", "propeller": "tunnel", "group": "A"}
    assert describe_thrusters([bow | {"kind": "azimuth", "propeller": "nozzle"}, bow]) == (
        "A: bow (azimuth, propeller: nozzle), bow (tunnel)"
    )
    main = {"name": "port", "kind": "main", "x_m": -34.0, "y_m": -4.5, "thrust_kN": 353.96}
    assert describe_thrusters([main | {"group": "B"}]) == (
        "B: port (main, x -34 m, y -4.5 m, 354 kN)"
    )


def test_a_tall_pdf_becomes_pages_from_the_top() -> None:
    """Every new object is where its table of references says, and the old table is before it."""
    tall = vlc.svg_to_pdf('<svg xmlns="http://www.w3.org/2000/svg" width="50" height="300"/>')
    pdf = split_into_pages(tall, 100)
    assert pdf.startswith(tall) and pdf.count(b"startxref") == 2
    boxes = re.findall(rb"MediaBox \[([0-9 ]+)\]", pdf[len(tall) :])
    assert boxes == [b"0 200 50 300", b"0 100 50 200", b"0 0 50 100"]
    table = pdf[int(re.findall(rb"startxref\s(\d+)", pdf)[-1]) :]
    entries = re.findall(rb"(\d+) 1\n(\d{10}) 00000 n\r\n", table)
    assert len(entries) == 4 and table.startswith(b"xref\n")
    assert all(pdf[int(at) :].startswith(b"%b 0 obj\n" % number) for number, at in entries)
    kids = re.findall(rb"/Kids \[([^]]+)\]", pdf)[-1]
    assert {*re.findall(rb"(\d+) 0 R", kids)} <= {number for number, _ in entries}


def test_it_names_the_commit_where_the_record_has_one(written: Any) -> None:
    results, facts = written.results, written.report.data
    old = make_statement_svg(written.folder, results, facts)
    suite = results.suite | {"revisions": [{"commit": "c0ffee" * 6, "clean": False}]}
    new = make_statement_svg(written.folder, replace(results, suite=suite), facts)
    assert "commit not known" in old and "commit not known" not in new
    assert "commit c0ffeec0ffee with changes" in new


def test_it_names_solvers_of_the_suite_that_were_not_selected(drawn: str, written: Any) -> None:
    """By name, also one with options; a solver with a run is not among them."""
    suite = written.results.suite | {"solvers": ["daqp", "ecos", "osqp[rho=2]", "mine", "own[a=1]"]}
    results = replace(written.results, suite=suite)
    svg = make_statement_svg(written.folder, results, written.report.data)
    text = " ".join("".join(element.itertext()) for element in _texts(svg))
    assert "3 of 5 solvers of the suite were selected; left out: mine and own." in text
    assert "left out" not in drawn


def test_it_says_why_a_compared_solver_is_inconclusive(records: Any, tmp_path: Path) -> None:
    """One that was replayed and never closed a loop."""
    out = _good(records, tmp_path)
    records.replay("quadprog", spread=0.1)
    results = records.results()
    svg = make_statement_svg(out, results, Report.from_results(results).data)
    text = " ".join("".join(element.itertext()) for element in _texts(svg))
    assert re.search(r"quadprog 1\.0 inconclusive, [^;]+ \(no closed loop was run\)\.", text)


def test_it_says_what_is_late_of_a_compared_solver_with_a_p99_in_the_limit(
    records: Any, tmp_path: Path
) -> None:
    """One step takes 400 ms, beyond the deadline of 300 ms; a p99 of 20 ms needs no reason."""
    out = _good(records, tmp_path)
    for solver, slow in (("quadprog", {"slow": {5: 2e4}}), ("osqp", {"median_us": 2e4})):
        records.loop(solver)
        records.replay(solver, spread=1e-3, **slow)
    results = records.results()
    svg = make_statement_svg(out, results, Report.from_results(results).data)
    text = " ".join("".join(element.itertext()) for element in _texts(svg))
    step = r"quadprog 1\.0 late, 2\d\.?\d* µs [^;]*\(its largest step time is 4\d\d ms"
    assert re.search(step, text)
    assert re.search(r"osqp 1\.0 late, 20[^;]* ms (\(95 %[^;)]*\))?[;.]", text)


def test_it_lists_what_is_assumed_of_ship_and_thrusters() -> None:
    """List of the source of a vessel, then the keys that the hull of level 1 leaves out."""
    osv = load_vessel("osv")
    own = replace(
        osv, source="scaled; limits: computed from the thrusters; assumed: rise times 7 s"
    )
    assert split_source(own) == ("scaled; limits: computed from the thrusters", "rise times 7 s")
    first, hull = list_assumptions_on_vessel(own)
    assert (
        first == "rise times 7 s"
        and hull.startswith("hull data from the main dimensions: length under water, ")
        and "_" not in hull
    )
    assert own.thrusters is not None
    bow, second, *rest = own.thrusters.thrusters
    bow, second = (
        replace(thruster, screw=Screw(3.0, "open", height_m))
        for thruster, height_m in ((bow, None), (second, 2.0))
    )
    thrusters = replace(own.thrusters, thrusters=(bow, second, *rest))
    _, shafts, _ = list_assumptions_on_vessel(replace(own, thrusters=thrusters))
    assert shafts == (
        "loss of thrust by ventilation in waves neglected, as shaft heights of "
        f"{bow.name} are unknown"
    )
    assert list_assumptions_on_vessel(load_vessel("supply_fs99")) == []


def test_it_has_the_settings_of_each_controller_and_what_is_not_modelled() -> None:
    """As in `problems/scenarios`: the values are typed here from these files."""
    rough, weather, commanded = map(load_scenario, ("rough", "weather", "thrusters"))
    first, second = describe_controllers([rough, weather, commanded])
    assert first == (
        "Controller in rough and weather: plans forces, sample time 0.3 s, prediction/control "
        "horizon 60/10 samples, Q = diag(1, 1, 3000) [1/m², 1/m², 1/rad²], R = "
        "diag(0.1, 0.1, 0.1)/(maximum increment)²."
    )
    table = commanded.files["scenario"]["controller"]["thrusters"]
    assert f"R = {table['move_weight_relative']:g}/(maximum increment)²" in second
    assert f"W = {table['thrust_weight_relative']:g}/(largest thrust)²" in second
    turning = "turning_degps is not used without azimuth_turning = true in the controller."
    assert list_model_gaps([commanded]) == [turning]
    limited = commanded.with_keys({"controller.thrusters.azimuth_turning": True})
    assert list_model_gaps([rough, limited]) == []
    assert commanded.vessel.thrusters is not None
    first_one, *others = commanded.vessel.thrusters.thrusters
    main = replace(first_one, kind="main", turning_radps=None, sector_rad=None)
    thrusters = replace(commanded.vessel.thrusters, thrusters=(main, *others))
    with_main = replace(limited, vessel=replace(limited.vessel, thrusters=thrusters))
    assert list_model_gaps([with_main]) == ["Rudders are not modelled."]


def test_wind_areas_of_ones_own_are_not_listed_as_assumed() -> None:
    """They are compared with the text of the source, whatever wrote it."""
    osv = load_vessel("osv")
    assert osv.windage is not None and osv.capability is not None
    hull = replace(osv.capability, assumed=())
    scaled = "wind areas 304 m² in front, 772 m² on the side, scaled from supply_mss"
    given = replace(osv.windage, frontal_m2=350.0, lateral_m2=772.2)
    own = replace(osv, source=f"x; assumed: rise times 7 s; {scaled}", capability=hull)
    mine = replace(own, windage=given)
    assert list_assumptions_on_vessel(mine) == ["rise times 7 s"]
    assert describe_own_wind_areas(mine) == (
        "wind areas as given: 350 m² in front, 772 m² on the side"
    )
    same = replace(own, windage=replace(given, frontal_m2=304.4))
    assert list_assumptions_on_vessel(same) == [f"rise times 7 s; {scaled}"]
    assert describe_own_wind_areas(same) == describe_own_wind_areas(osv) == ""
    alone = replace(mine, source=f"x; assumed: {scaled}")
    assert list_assumptions_on_vessel(alone) == []


def _body(svg: str) -> list[ElementTree.Element]:
    """Return the lines of a statement without the feet of its pages."""
    lines = _texts(svg)
    assert (lines[-1].text or "").startswith("Page ")
    pages = int((lines[-1].text or "").rpartition(" ")[2])
    assert [foot.text for foot in lines[-pages:]] == [
        f"Page {page} of {pages}" for page in range(1, pages + 1)
    ]
    return lines[:-pages]


def test_it_fits_its_pages(drawn: str) -> None:
    """As rendered, nothing is drawn beyond the margins; each line is below the one before."""
    heights = [float(line.get("y", "nan")) for line in _body(drawn)]
    assert heights == sorted(heights)
    assert all(MARGIN <= height % HEIGHT <= HEIGHT - 40 for height in heights)
    assert not re.search(r"\bnan\b|None", drawn)
    assert _rightmost_ink(drawn) <= WIDTH - MARGIN + 2


def _rightmost_ink(svg: str) -> float:
    """Return how far to the right [points] anything of a page is drawn but its background."""
    pixels = matplotlib.image.imread(io.BytesIO(vlc.svg_to_png(svg)))
    dark = (pixels[..., :3] < 0.9).any(axis=(0, 2))
    return float(np.flatnonzero(dark)[-1]) * WIDTH / len(dark)


@pytest.mark.parametrize("letters", ["mmmm", "illi", "WORD", "0123", "(x)/"])
def test_wrapped_lines_end_before_the_margin_and_use_the_page(letters: str) -> None:
    """Wide letters and narrow ones, in the font they are drawn in."""
    first, *_ = statement._wrap(" ".join(60 * [letters]), 8.0)
    svg = statement._render_svg([statement.TextLine(first)], None)
    words = svg.replace('height="1"', 'height="0"')
    assert MARGIN + 0.6 * (WIDTH - 2 * MARGIN) <= _rightmost_ink(words) <= WIDTH - MARGIN


@pytest.mark.parametrize("count", [16, 60])
def test_a_long_text_takes_more_pages_of_readable_letters(
    written: Any, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    """The signature is last. Text is set in 8 pt, and nothing in less than 6 pt."""
    lines = (f"Loss of board {i}: not held (not simulated)." for i in range(count))
    losses = OpenLosses(tuple(lines))
    monkeypatch.setattr(statement, "find_open_losses", lambda *_: losses)
    report = written.report
    svg = make_statement_svg(written.folder, report.results, report.data)
    heights = [float(line.get("y", "nan")) for line in _body(svg)]
    assert all(MARGIN <= height % HEIGHT <= HEIGHT - 40 for height in heights)
    # 60 lines of 8.5 pt take 700 points.
    assert heights[-1] > HEIGHT if count == 60 else heights[-1] < 2 * HEIGHT
    assert min(float(line.get("font-size", "nan")) for line in _texts(svg)) >= 6.0
    assert _rightmost_ink(svg) <= WIDTH - MARGIN + 2
    texts = ["".join(element.itertext()) for element in _body(svg)]
    assert texts[3] == losses.not_held[0] and texts[-1].startswith("Author ___")
    assert HEADING not in texts and "Recommended solver" in texts


def test_equal_ships_are_described_once(records: Any, tmp_path: Path) -> None:
    """Scenario files with a vessel file each: every name, but one description and one hash."""
    for name in ("thrusters_loss", "paper"):
        records.loop("daqp", name)
    records.replay("daqp", "thrusters_loss", spread=0.1)
    facts = Report.from_results(records.results()).data
    view = copy(facts.records)
    plain = view.build_scenario("thrusters_loss")
    twin = replace(plain, name="paper", vessel=replace(plain.vessel, id="twin_ship"))
    view._scenarios = {"thrusters_loss": plain, "paper": twin}
    folder, data = records.write(tmp_path / "out"), replace(facts, records=view)
    lines = _texts(make_statement_svg(folder, records.results(), data))
    text = " ".join("".join(element.itertext()) for element in lines)
    vessel = plain.vessel
    assert f"Ship: {vessel.title} ({vessel.id}, twin_ship); " in text
    assert text.count(split_source(vessel)[0]) == 1
    assert text.count("y to starboard): board A: ") == text.count("board A: ") == 1
    assert f"vessel {vessel.id} and 1 equal (stored document)  SHA-256 " in text


def test_it_says_that_the_model_lacks_the_drag_of_the_ship(written: Any) -> None:
    """Beside the ships; without such a ship it says nothing of it."""
    facts, (name, *_) = written.report.data, written.report.data.records.scenarios
    hull, records = HullDrag(1.0, 1.0, 0.0, 76.2, 0.1), copy(facts.records)
    plain = records.build_scenario(name)
    dragged = replace(plain, vessel=replace(plain.vessel, id="own", drag=hull))
    records._scenarios = {**records._scenarios, name: dragged}
    with_drag = replace(facts, records=records)
    for data, count in ((facts, 0), (with_drag, 1)):
        svg = make_statement_svg(written.folder, written.results, data)
        text = " ".join("".join(element.itertext()) for element in _texts(svg))
        assert text.count("Cross-flow drag acts on the ship") == count
        assert text.count("No Munk moment of the current acts on the ship") == count


def test_the_ship_comes_first_and_is_drawn(drawn: str) -> None:
    texts = ["".join(element.itertext()) for element in _texts(drawn)]
    assert texts[2] == "Ship, independent of the solver"
    assert texts[3].startswith("With exactly solved QPs, the controller holds the ship")
    assert "paper: on station; largest offset 1.77 m at the start, last 0.0400 m" in "".join(texts)
    root = ElementTree.fromstring(drawn)
    line, *_ = (element for element in root.iter() if element.tag.endswith("polyline"))
    corners = [tuple(map(float, pair.split(","))) for pair in line.get("points", "").split()]
    assert len(corners) > 100
    assert all(MARGIN <= x <= WIDTH - MARGIN and 0 < y < HEIGHT for x, y in corners)


@pytest.mark.slow
def test_a_lost_ship_is_the_first_line_of_its_statement(records: Any, tmp_path: Path) -> None:
    left = {"exact_left_s": 9.0, "exact_offset_max_m": 37.0, "exact_offset_end_m": 36.0}
    records.loop("daqp", tail_m=40.0, **left)
    records.replay("daqp", spread=0.1)
    out = records.write(tmp_path / "out")
    assert main(["report", str(out), "--statement", str(tmp_path / "a.svg"), "--strict"]) == 1
    drawn = (tmp_path / "a.svg").read_text("utf-8")
    texts = ["".join(element.itertext()) for element in _texts(drawn)]
    assert texts[3].startswith(BANNER) and texts.index(HEADING) > 3
    assert not any("ecommend" in text for text in texts)
    assert "stroke-dasharray" in drawn


def test_scenarios_with_a_loss_come_first_the_farthest_off_of_all(
    records: Any, tmp_path: Path
) -> None:
    """The DP capability number rests on a single failure: the scenario without one comes last."""
    for name, far_m in (("paper", 3.0), ("thrusters_loss", 1.0), ("thruster_loss", 2.0)):
        records.loop("daqp", name, exact_offset_max_m=far_m)
    records.replay("daqp", spread=0.1)
    results = records.results()
    svg = make_statement_svg(
        records.write(tmp_path / "out"), results, Report.from_results(results).data
    )
    lines = ["".join(element.itertext()) for element in _texts(svg)]
    found = [re.match(r"(\w+): (?:on station|leaves|not arrived)", line) for line in lines]
    assert [m[1] for m in found if m] == ["thruster_loss", "thrusters_loss", "paper"]


def test_it_states_weather_losses_thrusters_and_source(records: Any, tmp_path: Path) -> None:
    """Those of the scenario file and of the vessel file; the figure marks the loss."""
    records.loop("daqp", "thrusters_loss", steps=500)
    records.replay("daqp", "thrusters_loss", spread=0.1)
    results = records.results()
    report = Report.from_results(results)
    svg = make_statement_svg(records.write(tmp_path / "out"), results, report.data)
    lines = ["".join(element.itertext()) for element in _texts(svg)]
    text = " ".join(lines)
    assert "loss of board A at 90 s" in text and "loss of board A" in lines
    assert "to starboard): board A: " in text
    assert "wind " in text and " m/s from " in text and "current " in text
    assert max(len(line) * 3.5 for line in lines) <= WIDTH
    names = ("offset", "heading error", "thrust")
    titles = {name: line for name in names for line in lines if line.startswith(f"largest {name} ")}
    panels = list(titles)
    assert re.fullmatch(r"largest offset [\d.e-]+ m \([\d.]+ s\)", titles["offset"])
    assert len(panels) == svg.count("<polyline") >= 2
    assert "around the loss of board A in thrusters_loss, 30" in text


def test_rudders_are_named_with_the_notation_and_above_it(
    records: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A solver that leaves alarms unanswered is named as compared."""
    records.loop("daqp", "thrusters_loss", steps=500)
    records.replay("daqp", "thrusters_loss", spread=0.1)
    records.replay("quadprog", "thrusters_loss", spread=0.1)
    rows = [(case, at, 30.0) for case in ("intact", "board A") for at in range(0, 360, 10)]
    table = pd.DataFrame(rows, columns=["case", "from_deg", "edge_mps"])
    table = table.assign(k=range(72), sequence="p", vessel="ratownik", sides=8, lost="", number=8)
    monkeypatch.setattr(statement, "load_capability_plots", lambda _: table)
    caution = "Aft of midships only main propellers push: rudders are not counted."
    monkeypatch.setattr(ThrusterSet, "caution_on_rudders", property(lambda _: caution))
    silent = "leaves 9 of 9 QPs of the consequence analysis unanswered"
    monkeypatch.setattr(
        statement, "describe_unanswered_qps", lambda _, solver: f"{solver} {silent}"
    )
    report = Report.from_results(records.results())
    svg = make_statement_svg(records.write(tmp_path / "out"), records.results(), report.data)
    lines = ["".join(element.itertext()) for element in _texts(svg)]
    at = lines.index(caution)
    assert lines[at + 1].startswith("DP capability-L1(8, 8, 8, 8) without rudders. ")
    assert f"quadprog {silent}." in " ".join(lines)

"""The paper: claims, choices and stability follow the records."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.design import Bracket, DesignRecord, Designs, UnanalysedStability
from dpbench.bench.record.result_folder import Results
from dpbench.report.topics.all import build_topics
from dpbench.report.topics.paper import (
    Claim,
    build_paper_topic,
    describe_count_reproduced,
    judge_claims,
    list_choices,
)
from tests.result_folder import StepsInMemory

WHOLE = 1000
"""Steps of the paper's case: 300 s in samples of 0.3 s."""


def _states(records: Any) -> dict[str, str]:
    return {claim.claim: claim.state for claim in judge_claims(records.view())}


def _pair(records: Any, scenario: str = "paper", **law: Any) -> None:
    records.loop("daqp", scenario, steps=WHOLE)
    baseline_law = {
        "steps": WHOLE,
        "settle_0p1m_s": 64.0,
        "overshoot_e": 1.13,
        "heading_max_deg": 0.3,
    }
    records.loop("unconstrained_clipped", scenario, formulation="none", **(baseline_law | law))


@pytest.mark.slow
def test_claims_of_the_paper_case(records: Any) -> None:
    _pair(records)
    _pair(records, "paper_tight", tail_m=9.0, settle_0p1m_s=np.inf)
    states = _states(records)
    topic = build_paper_topic(records.view())
    assert topic.lines[0].startswith(f"{len(states) - 2} of {len(states)} claims")
    assert [row[-1] for row in topic.tables[0].rows] == list(states.values())
    failed = [claim for claim, state in states.items() if state != "reproduced"]
    assert all(claim.replace("`", "") in topic.lines[0] for claim in failed)
    assert failed == [
        "The constrained law has a smaller steady-state error (`paper` tuning)",
        "The constrained law has a smaller heading error (Fig. 5)",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "value", "claim"),
    [
        ("overshoot_e", 0.9, "The constrained law is smoother in the transient: less overshoot"),
        ("settle_0p1m_s", 40.0, "The constrained law settles earlier (Fig. 5)"),
    ],
)
def test_contradicting_rows_are_believed(
    records: Any, column: str, value: float, claim: str
) -> None:
    _pair(records, **{column: value})
    assert _states(records)[claim] == "contradicted"
    topic = build_paper_topic(records.view())
    assert topic is not None
    assert f"“{claim}”" in topic.lines[0].split("The simulation contradicts the claim")[1]


@pytest.mark.parametrize(
    ("columns", "claim"),
    [
        ({"limit_violations": 1}, "No limit is ever violated (Figs. 6 and 7)"),
        ({"clipped": 1}, "No limit is ever violated (Figs. 6 and 7)"),
        ({"at_rate_sway": 0.0}, "The rate limits shape the transfer (Fig. 7)"),
        ({"tail_m": 1.2}, "The ship is held within the 1 m precision circle (Fig. 4)"),
        (
            {"tail_m": 0.06},
            "The ship is nearly stationary in the circle (steady-state error below 5 cm)",
        ),
    ],
)
def test_claims_on_a_law_follow_its_row(records: Any, columns: dict[str, Any], claim: str) -> None:
    records.loop("daqp", steps=WHOLE, **columns)
    assert _states(records)[claim] == "not reproduced"


@pytest.mark.parametrize(
    ("outside", "says"),
    [
        (range(0), "within 1 m from the start; largest radial error after that 0.700 m"),
        (
            range(34),
            "enters the 1 m circle at 10.2 s and stays in it; largest radial error after that "
            "0.700 m",
        ),
        (
            [0, 3, 500],
            "enters the 1 m circle at 150 s and stays in it; largest radial error after that "
            "0.700 m",
        ),
        ([0, WHOLE - 1], "outside 1 m at the end"),
    ],
)
def test_held_is_to_enter_and_to_stay(records: Any, outside: Any, says: str) -> None:
    records.loop("daqp", steps=WHOLE)
    found = records.results()
    steps = found.steps.copy()
    steps[["n_m", "e_m"]] = 0.0
    steps.loc[steps["k"] == 900, "e_m"] = -0.7
    steps.loc[steps["k"].isin(list(outside)), "n_m"] = 1.5
    view = Records(Results(found.runs, StepsInMemory(steps), found.machine, found.suite))
    assert judge_claims(view)[0].found == says


def test_an_inaccurate_solver_is_named_with_its_error(records: Any) -> None:
    """A claim that its loop contradicts is not held against the paper."""
    records.loop("osqp", steps=WHOLE, error=0.22, limit_violations=9)
    line = build_paper_topic(records.view()).lines[0]
    assert "does not reproduce the claim “No limit is ever violated (Figs. 6 and 7)”. The" in line
    used = "The simulation used `osqp`, which is not accurate enough: the error of its first move "
    assert f"{used}reaches 0.22 times the maximum increment in `paper`" in line
    records.loop("daqp", steps=WHOLE)
    assert "The simulation used" not in build_paper_topic(records.view()).lines[0]


def test_without_the_paper_nothing_is_claimed(records: Any) -> None:
    records.loop("daqp", "calm")
    assert set(_states(records).values()) == {"not simulated"}
    assert list_choices(records.view()) == []


def test_a_run_cut_short_represents_nobody(records: Any) -> None:
    records.loop("cut", steps=WHOLE, error=1e-15, done=20, outcome="timed_out")
    records.loop("inexact", steps=WHOLE, error=0.3, tail_m=2.0)
    records.loop("exact", steps=WHOLE, error=1e-12)
    assert _states(records)["The ship is held within the 1 m precision circle (Fig. 4)"] == (
        "reproduced"
    )


def test_claims_that_were_not_measured_are_counted(records: Any) -> None:
    """Without the baseline law no claim that compares the two is measured."""
    records.loop("daqp", steps=WHOLE)
    states = list(_states(records).values())
    reproduced, missing = states.count("reproduced"), states.count("not simulated")
    assert reproduced > 0
    assert missing > 0
    topic = build_paper_topic(records.view())
    assert topic is not None
    assert topic.lines[0].startswith(f"{reproduced} of {len(states)} claims")
    assert f"{missing} not simulated" in topic.lines[0]
    assert "add `--solver unconstrained_clipped` to run the baseline law" in topic.lines[0]
    unmeasured = {row[2] for row in topic.tables[0].rows if row[3] == "not simulated"}
    assert any("`--solver unconstrained_clipped` adds it" in found for found in unmeasured)


def test_the_words_of_the_paper_are_beside_the_results(records: Any) -> None:
    """The paper has no measured value, and the limit of 5 cm is not its own."""
    records.loop("daqp", steps=WHOLE)
    table = build_paper_topic(records.view()).tables[0]
    assert table.heads == ("claim", "paper states", "simulated here", "state")
    stated = {row[0]: row[1] for row in table.rows}
    assert all(stated.values())
    five_cm = stated["The ship is nearly stationary in the circle (steady-state error below 5 cm)"]
    assert "no number" in five_cm and "5 cm is set by dpbench" in five_cm
    assert (
        "not stated in the text"
        in stated["The constrained law has a smaller heading error (Fig. 5)"]
    )
    assert "depend on these values. The documentation page on the paper" in table.note


@pytest.mark.slow
def test_choices_are_those_of_the_rows(records: Any) -> None:
    _pair(records)
    found = dict(list_choices(records.view()))
    topic = build_paper_topic(records.view())
    assert topic is not None and dict(topic.tables[1].rows) == found
    assert found["output weight Q"].startswith("diag(1, 1, 100)")
    assert found["disturbance, amplitude"].startswith("100, 80, 3\u202f000")
    assert {"simulated ship", "initial velocity"} <= found.keys()
    scenario = records.scenario("paper")
    assert (scenario.true_ship.M == scenario.vessel.M).all()
    assert (scenario.true_ship.D == scenario.vessel.D).all()
    assert scenario.actuators is None and not scenario.velocity.any()


def test_a_claim_takes_the_whole_scenario(records: Any) -> None:
    """A complete run over the first 60 of 1000 steps measures no claim, and its length is told."""
    records.loop("daqp", steps=60)
    records.loop("unconstrained_clipped", steps=60, formulation="none", error=1.0)
    found = [claim for claim in judge_claims(records.view()) if "paper_tight" not in claim.claim]
    assert {claim.state for claim in found} == {"not simulated"}
    assert {claim.found for claim in found} == {"60 of 1\u202f000 steps"}


def _called_paper(records: Any, change: Callable[[dict[str, Any]], None]) -> Results:
    """Whole runs of a scenario called `paper` whose documents have been changed."""
    _pair(records)
    found = records.results()
    files = json.loads(json.dumps(records.scenario("paper").files))
    change(files)
    runs = found.runs.assign(cell=json.dumps({"scenario": files}))
    return Results(runs, found.recorded, found.machine, found.suite)


@pytest.mark.parametrize("part", ["sea", "ship"])
def test_a_namesake_is_not_the_paper(records: Any, part: str) -> None:

    def change(files: dict[str, Any]) -> None:
        if part == "sea":
            files["scenario"]["environment"]["amplitude_kN"][0] += 1.0
        else:
            files["vessel"]["length_m"] += 1.0

    results = _called_paper(records, change)
    view = Records(results)
    assert {claim.state for claim in judge_claims(view)} == {"not simulated"}
    assert list_choices(view) == []
    assert build_paper_topic(view) is None


@pytest.mark.slow
def test_reworded_prose_is_still_the_paper(records: Any) -> None:

    def change(files: dict[str, Any]) -> None:
        files["scenario"]["title"] = "Another title"

    topic = build_paper_topic(Records(_called_paper(records, change)))
    assert [figure.name for figure in topic.figures] == [
        "paper-path",
        "paper-errors",
        "paper-forces",
        "paper-increments",
    ]


PAPER = DesignRecord(
    vessel="tug",
    controller="paper",
    tuning="paper",
    N_p=30,
    N_c=5,
    eigenvalues=((0.9, 0.1), (0.9, -0.1), (0.5, 0.0)),
    held={"still water": Bracket(1.0, 1.046875), "calm": Bracket(0.5, 0.515625)},
)
ROBUST = replace(
    PAPER,
    controller="rough",
    tuning="robust",
    N_p=60,
    N_c=10,
    eigenvalues=((1.02, 0.0),),
    held={"still water": Bracket(64.0, None), "calm": Bracket(0.0, 0.25)},
)
MISSING = UnanalysedStability("tug", "turn", "killed by SIGKILL")
DESIGNS = Designs((PAPER, ROBUST))


def _rows(designs: Designs | None, records: Any) -> list[tuple[str, ...]]:
    """The rows of the table on stability; none where there is no such table."""
    records.loop("daqp", steps=1000)
    topic = build_paper_topic(records.view(), designs)
    return [row for table in topic.tables if "Stability" in table.title for row in table.rows]


@pytest.mark.slow
def test_the_table_shows_the_numbers_of_the_records(records: Any) -> None:
    none = replace(PAPER, held={})
    paper, robust, unknown = _rows(Designs((PAPER, ROBUST, none), (MISSING,)), records)
    assert paper == ("paper 30/5, ship tug", "0.9055", "1.00 – 1.05", "0.500 – 0.516")
    assert robust == ("robust 60/10, ship tug", "1.0200", "≥ 64", "< 0.250")
    assert unknown[2:] == ("–", "–")


def test_the_note_names_the_commands_for_offsets_that_were_not_tested(records: Any) -> None:
    """`dpbench paper` tests none; a suite with a table `[design]` tests all."""
    records.loop("daqp", steps=1000)
    for record, count in ((replace(PAPER, held={}), 1), (PAPER, 0)):
        topic = build_paper_topic(records.view(), Designs((record,)))
        remedy = (
            "`dpbench check paper` computes that in still water, and a suite with a table "
            "`[design]` computes both."
        )
        assert topic.tables[-1].note.count(remedy) == count


def test_without_the_paper_stability_is_a_part_of_its_own(records: Any) -> None:
    records.loop("daqp", "rough", steps=1000)
    topics = build_topics(records.view(), judge_solvers(records.view(), Requirements()), DESIGNS)
    (topic,) = (topic for topic in topics if topic.id == "stability")
    assert topic.lines == ("1 of 2 controllers is stable without active limits.",)
    assert [row[1] for row in topic.tables[0].rows] == ["0.9055", "1.0200"]
    assert not topic.tables[0].folded


@pytest.mark.slow
def test_without_designs_there_is_no_such_table(records: Any) -> None:
    assert _rows(None, records) == []


def test_the_count_names_what_a_figure_or_dpbench_decides(records: Any) -> None:
    """Three claims are read from a figure and two limits are dpbench's, one of them in both."""
    claims = judge_claims(records.view())
    assert len(claims) == 9
    all_held = [Claim(one.claim, one.stated_in_paper, "", "reproduced") for one in claims]
    assert describe_count_reproduced(all_held) == (
        "9 of 9 claims of Xia, Liu, Pang & Xue are reproduced; 5 of these 9 are read from a "
        "figure, or tested with a limit or weights chosen by dpbench"
    )
    quoted = [one for one in all_held if one.stated_in_paper.startswith("“")]
    quoted = [one for one in quoted if "dpbench" not in one.stated_in_paper]
    assert describe_count_reproduced(quoted).endswith("are reproduced")

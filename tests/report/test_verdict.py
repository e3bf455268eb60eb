"""The verdict against hand-made rows."""

import math
import re
from typing import Any

import pytest

from dpbench.report.blocks import Cards
from dpbench.report.demand import Demand, demand_text
from dpbench.report.fastest_text import duel_text
from dpbench.report.ranking import duel, fastest_first
from dpbench.report.render import render_markdown
from dpbench.report.section_verdict import verdict_lines, verdict_section, verdict_table
from dpbench.report.verdict import judge, judge_all
from dpbench.report.verdict_text import contrast, elsewhere, sentence, summary
from dpbench.report.write import build_page

DEMAND = Demand()


def _verdict(records: Any, solver: str, settings: str = "default") -> Any:
    return judge(records.view(), solver, settings, DEMAND)


def test_exact_and_fast_meets(records: Any) -> None:
    """A solver that is right on every step and fast enough meets the demand."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0)
    verdict = _verdict(records, "daqp")
    assert verdict.outcome == "meets"
    assert verdict.steps == 120 + 1000
    assert sentence(verdict, DEMAND).startswith("**daqp** meets the demand: error_move at most")


CAUSES = [
    ({"error": 0.43}, {}, "its first move is up to 0.43 of a rate-limit step off the optimum in"),
    ({"error": math.inf}, {}, "it leaves steps without an answer in `paper`"),
    ({"failed": 3}, {}, "3 of 120 steps fail in `paper`"),
    ({}, {"median_us": 4000.0}, "its p99 is"),
    ({}, {"median_us": 4000.0, "steps": 300}, "its p95 is already"),
    ({}, {"failed": 2}, "2 of 3\u202f000 steps fail in the replay of `paper`"),
    ({}, {"error": 0.2}, "off the optimum in the replay of `paper`"),
]


@pytest.mark.parametrize(("loop", "replay", "clause"), CAUSES)
def test_each_cause_has_its_sentence(
    records: Any, loop: dict[str, Any], replay: dict[str, Any], clause: str
) -> None:
    """Whatever contradicts the demand makes a solver miss it, and the sentence says what."""
    records.loop("daqp", **loop)
    records.replay("daqp", **replay)
    verdict = _verdict(records, "daqp")
    assert verdict.outcome == "misses"
    assert clause in sentence(verdict, DEMAND)


DOUBTS = [
    ({"outcome": "timed_out", "done": 40}, "`paper` was stopped at its time limit (40 of 120"),
    (
        {"outcome": "crashed", "outcome_detail": "signal 11", "done": 0},
        "`paper` crashed: signal 11",
    ),
    ({"uncertified": 2}, "2 steps of `paper` have no certified optimum"),
]


@pytest.mark.parametrize(("loop", "clause"), DOUBTS)
def test_what_was_not_measured_leaves_it_open(
    records: Any, loop: dict[str, Any], clause: str
) -> None:
    """A run that ended early contradicts nothing and proves nothing."""
    records.loop("daqp", **loop)
    records.replay("daqp")
    verdict = _verdict(records, "daqp")
    assert verdict.outcome == "open"
    assert clause in sentence(verdict, DEMAND)


def test_a_replay_cut_after_a_whole_round_still_counts(records: Any) -> None:
    """Once every step has been replayed, rounds that are missing leave nothing open."""
    records.loop("daqp")
    records.replay("daqp", rounds=1, stopped=True)
    assert _verdict(records, "daqp").outcome == "meets"


def test_without_replay_time_is_not_judged(records: Any) -> None:
    """Without a replay nobody is said to be fast enough."""
    records.loop("daqp")
    verdict = _verdict(records, "daqp")
    assert verdict.outcome == "open"
    assert "its time is not judged" in sentence(verdict, DEMAND)
    assert math.isnan(verdict.p99_ns)


def test_too_few_steps_for_a_p99(records: Any) -> None:
    """With few steps the slowest one decides, and it cannot decide when it is over the demand."""
    for solver, median in (("fast", 20.0), ("near", 1500.0)):
        records.loop(solver)
        records.replay(solver, steps=300, median_us=median, spread=0.38)
    assert _verdict(records, "fast").outcome == "meets"
    near = _verdict(records, "near")
    assert near.outcome == "open"
    assert "do not support a p99" in sentence(near, DEMAND)


def test_a_refused_solver_was_not_run(records: Any) -> None:
    """A solver that is not installed is neither good nor bad, and its reason is told."""
    records.refused("qpax", "qpax is not installed: install the extra jax")
    verdict = _verdict(records, "qpax")
    assert verdict.outcome == "not run"
    assert "install the extra jax" in sentence(verdict, DEMAND)


def test_the_demand_is_read_from_the_suite(records: Any) -> None:
    """Whoever demands less sees more solvers meet it."""
    records.loop("osqp", error=0.05)
    records.replay("osqp")
    looser = Demand.of({"demand": {"error_move": 0.1, "unknown": 1}})
    assert judge(records.view(), "osqp", "default", looser).outcome == "meets"
    assert _verdict(records, "osqp").outcome == "misses"
    assert "within 0.1 of a rate-limit step" in demand_text(looser)


def test_slowdown_is_deadline_over_largest_step(records: Any) -> None:
    """The slow-down is the deadline over the largest algorithmic step time of all replays.

    With no spread every algorithmic time is the median itself; it is rounded to 1 ns.
    """
    records.loop("daqp")
    records.replay("daqp", median_us=20.0, spread=0.0)
    records.replay("daqp", "rough[900:1400]", steps=500, median_us=30.0, spread=0.0)
    assert _verdict(records, "daqp").slowdown(DEMAND) == pytest.approx(300e6 / 30e3, rel=1e-4)


def test_closed_loop_times_never_enter(records: Any) -> None:
    """However slow a closed loop was, the time that is judged comes from replays."""
    records.loop("daqp", raw_max_ns=1e12, raw_p50_ns=1e12)
    records.replay("daqp", median_us=20.0)
    assert _verdict(records, "daqp").outcome == "meets"


def test_high_settings_rescue(records: Any) -> None:
    """A solver that is right only at tight tolerances is said to be so, by name."""
    records.loop("osqp", error=0.4)
    records.loop("osqp", settings="high", steps=60)
    records.replay("osqp", error=0.4)
    records.replay("osqp", settings="high")
    verdicts = judge_all(records.view(), DEMAND)
    assert [v.outcome for level in verdicts.values() for v in level] == ["misses", "meets"]
    assert "Only with settings `high`: osqp." in summary(verdicts)
    text = elsewhere(verdicts, verdicts["default"][0])
    assert text.startswith(" It meets the demand only with settings `high`: error_move at most")
    assert "1\u202f060 judged steps" in text


def test_summary_counts_everybody_once(records: Any) -> None:
    """Every solver is named in exactly one sentence of the summary."""
    records.loop("daqp")
    records.replay("daqp")
    records.loop("osqp", error=0.4)
    records.replay("osqp")
    records.loop("scs", outcome="timed_out", done=10)
    records.refused("qpax", "not installed")
    text = summary(judge_all(records.view(), DEMAND))
    assert text == [
        "1 of 3 solvers that ran meets the demand with settings `default`: daqp.",
        "osqp misses it.",
        "scs cannot be judged on these records.",
        "Not run: qpax.",
    ]


def test_order_is_by_p99(records: Any) -> None:
    """The faster p99 comes first, whatever the order in the records."""
    for solver, median in (("slow", 90.0), ("fast", 20.0), ("middle", 40.0)):
        records.loop(solver)
        records.replay(solver, median_us=median)
    ranked = fastest_first(judge_all(records.view(), DEMAND)["default"])
    assert [v.solver for v in ranked] == ["fast", "middle", "slow"]


def _duel(records: Any, median_us: float) -> Any:
    for solver, median in (("first", 20.0), ("second", median_us)):
        records.loop(solver)
        records.replay(solver, median_us=median, spread=0.1)
    view = records.view()
    ranked = fastest_first(judge_all(view, DEMAND)["default"])
    return duel(view, ranked[0], ranked[1])


def test_a_clear_lead_is_called_so(records: Any) -> None:
    """Two solvers a factor of two apart are told apart, with ratio and interval.

    The geometric mean of 1000 paired ratios of spread 0.14 is within 2 % of 2 (4 sigma).
    """
    found = _duel(records, 40.0)
    assert found.ratio.value == pytest.approx(2.0, rel=0.02)
    assert not found.tied
    assert duel_text(found).startswith("Second: second takes")


def test_a_tie_is_called_a_tie(records: Any) -> None:
    """Two solvers with the same distribution of times are not ranked against each other."""
    found = _duel(records, 20.0)
    assert found.tied
    assert "cannot be told apart" in duel_text(found)


def test_an_order_that_turns_with_the_yardstick_is_called_unstable(records: Any) -> None:
    """A better p99 with a worse median is no clear lead."""
    records.loop("steady")
    records.replay("steady", median_us=40.0, spread=0.01)
    records.loop("nervous")
    records.replay("nervous", median_us=20.0, spread=0.6)
    view = records.view()
    ranked = fastest_first(judge_all(view, DEMAND)["default"])
    assert [v.solver for v in ranked] == ["steady", "nervous"]
    text = duel_text(duel(view, *ranked))
    assert text.startswith("Caution") and "depends on the yardstick" in text


def test_the_contrast_law_is_never_ranked(records: Any) -> None:
    """The clipped unconstrained law is no solver: it has a line of its own and no verdict."""
    records.loop("daqp")
    records.loop("unconstrained_clipped", steps=1000, formulation="none", tail_m=9.0, error=1.0)
    verdicts = judge_all(records.view(), DEMAND)
    assert [v.solver for v in verdicts["default"]] == ["daqp"]
    assert "9.0 m in `paper`" in contrast(records.view())


def test_the_table_names_every_solver_best_first(records: Any) -> None:
    """The verdict table has one row per solver: those that meet it by p99, then the rest."""
    for solver, median, error in (("a", 50.0, 1e-9), ("b", 20.0, 1e-9), ("c", 10.0, 0.5)):
        records.loop(solver, error=error)
        records.replay(solver, median_us=median)
    table = verdict_table(judge_all(records.view(), DEMAND), DEMAND)
    assert [row[0].text for row in table.rows] == ["b", "a", "c"]


def test_terminal_lines_carry_no_markup(records: Any) -> None:
    """The lines for a terminal are plain text."""
    records.loop("daqp")
    records.replay("daqp")
    text = "\n".join(verdict_lines(records.view(), DEMAND))
    assert "daqp" in text
    assert not {"*", "`"} & set(text)


def test_the_contrast_is_judged_on_whole_runs_only(records: Any) -> None:
    """Of a contrast law that ran a part of the scenario the steps are told, and no steady error."""
    records.loop("unconstrained_clipped", steps=60, formulation="none", tail_m=9.0, error=1.0)
    text = contrast(records.view())
    assert "second half" not in text
    assert "60 of 1\u202f000 steps in `paper`" in text


def test_one_slowdown_in_every_place(records: Any) -> None:
    """Sentences, table and card tell one slow-down, rounded down, that still makes the deadline.

    Largest steps of 210.2 and 300.7 µs are 1427.2 and 997.7 times shorter than 300 ms; rounding
    to the nearest would make 1430 and 998, which miss it.
    """
    for solver, largest_us in (("daqp", 210.2), ("piqp", 300.7)):
        records.loop(solver)
        records.replay(solver, median_us=largest_us, spread=0.0)
    text = render_markdown(build_page(records.results()))
    told = set(re.findall(r"a computer ([0-9.]+) times slower would still make the 0.3 s", text))
    listed = set(re.findall(r"× ([0-9.]+)", text)) & told
    assert told == listed == {"1420", "997"}
    assert re.search(r"slow-down it stands: \*\*× 1420\*\*", text)
    assert "would miss" not in text


def test_without_replays_nothing_is_denied(records: Any) -> None:
    """Where no replay was run, it is open whether a solver meets the demand, and said to be so."""
    for solver in ("daqp", "quadprog"):
        records.loop(solver)
    text = "\n".join(verdict_lines(records.view(), DEMAND))
    assert text.startswith("Nothing can be judged on time: no replay was run.")
    assert "No solver meets" not in text and "0 of 2" not in text
    cards = verdict_section(records.view(), DEMAND).blocks[2]
    assert isinstance(cards, Cards)
    assert (cards.cards[0].value, cards.cards[0].mark) == ("open", "warn")


def test_open_outcomes_are_not_counted_as_misses(records: Any) -> None:
    """One miss and one open outcome leave it open whether a solver meets the demand."""
    records.loop("daqp", outcome="timed_out", done=10)
    records.replay("daqp")
    records.loop("osqp", error=0.4)
    records.replay("osqp")
    text = "\n".join(verdict_lines(records.view(), DEMAND))
    assert "is open: 1 of 2 solvers that ran cannot be judged" in text
    assert "No solver meets" not in text


def test_a_miss_by_all_is_a_miss(records: Any) -> None:
    """When every solver that ran misses the demand, it is said that none meets it."""
    records.loop("osqp", error=0.4)
    records.replay("osqp")
    text = "\n".join(verdict_lines(records.view(), DEMAND))
    assert text.startswith("0 of 1 solver that ran meet the demand")
    assert "No solver meets the demand" in text

"""What the page says of its times: one rule for when two differ, and what nobody could watch."""

from __future__ import annotations

from typing import Any

from dpbench.analysis.times.machine import round_spread
from dpbench.report.formats import significant
from dpbench.report.topics.trust import trust_topic


def test_one_sentence_says_which_figure_applies_to_what(records: Any) -> None:
    """The interval within the run; against another run what the rounds of 95 % differ by."""
    records.replay("daqp", replay_s=9.0)
    view = records.view()
    topic = trust_topic(view)
    assert topic is not None
    usual, high = round_spread(view)
    rule = topic.lines[0]
    assert "95 % interval of their pair" in rule
    assert f"another run or day only beyond × {significant(high)}." in rule
    assert f"(median {significant(usual)})" in rule


def test_what_the_machine_hides_is_said(records: Any) -> None:
    records.replay("daqp", replay_s=9.0, rerun_rounds=2, involuntary_switches=0, steal_s=0.0)
    topic = trust_topic(records.view())
    assert topic is not None
    (quiet,) = (line for line in topic.lines if line.startswith("The machine was quiet"))
    assert "disturbed even when run again, as 2 were." in quiet
    assert quiet.endswith("Not watched, as the machine hides it: its frequency and throttling.")


def test_a_wait_is_said_by_its_largest_replay(records: Any) -> None:
    for sequence, median_us in (("calm", 50.1), ("paper", 52.0), ("rough", 50.2)):
        records.replay("busy_wait_50us", sequence, median_us=median_us, replay_s=1.0)
    topic = trust_topic(records.view())
    assert topic is not None
    (waits,) = (line for line in topic.lines if line.startswith("Waits of known length"))
    assert "50 µs as 52.0 µs (p50 of the timings that count, the largest of its replays)" in waits
    assert "known to 4.0 %" in waits
    assert "busy_wait_50us 52.0 µs" in records.ending()["harness"]

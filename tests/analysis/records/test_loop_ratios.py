"""A replay is compared with the closed loop over the steps that both have."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records import loop_ratios
from dpbench.analysis.records.loop_ratios import compare_loops_over_replayed_steps

EASY_NS, HARD_NS = 10.0, 200.0


def _steps(first_hard: int, steps: int) -> pd.DataFrame:
    k = np.arange(steps)
    return pd.DataFrame({"k": k, "total_ns": np.where(k < first_hard, EASY_NS, HARD_NS)})


def _run(mode: str, *, first_step: int = 0, **values: Any) -> Any:
    usual = {
        "mode": mode,
        "scenario": "loss",
        "configuration": "daqp",
        "study": "",
        "slowdown": 0.0,
        "outcome": "finished",
        "failed_steps": 0,
        "steps_done": 2000,
        "scenario_documents": {"scenario": {"controller": {"kind": "thrusters"}}},
        "first_step": first_step,
        "caching_sign": ("loop", 20.0),
        "loop_ratio": 20.0,
        "loop_tail_ratio": 20.0,
    }
    return SimpleNamespace(**(usual | values))


def _compare(monkeypatch: pytest.MonkeyPatch, replay: Any, loop: Any, tables: Any) -> Any:
    """Return the compared replay; runs are namespaces, which `replace` does not copy."""

    def replace(run: Any, **values: Any) -> Any:
        return SimpleNamespace(**(vars(run) | values))

    monkeypatch.setattr(loop_ratios, "replace", replace)
    return compare_loops_over_replayed_steps([replay, loop], lambda run: tables[run.mode])[0]


def test_harder_steps_behind_the_replay_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss at step 900 makes most steps of the loop hard, and 100 of those of the replay."""
    tables = {"replay": _steps(900, 1000), "closed_loop": _steps(900, 2000)}
    found = _compare(monkeypatch, _run("replay"), _run("closed_loop"), tables)
    assert (found.loop_ratio, found.loop_tail_ratio) == (1.0, 1.0)


def test_cached_answers_are_still_found(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {"replay": _steps(1000, 1000), "closed_loop": _steps(0, 2000)}
    found = _compare(monkeypatch, _run("replay"), _run("closed_loop"), tables)
    assert (found.loop_ratio, found.loop_tail_ratio) == (HARD_NS / EASY_NS, HARD_NS / EASY_NS)


def test_a_later_part_is_compared_with_its_own_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {"replay": _steps(0, 500), "closed_loop": _steps(1000, 2000)}
    later = _run("replay", first_step=1000)
    assert _compare(monkeypatch, later, _run("closed_loop"), tables).loop_ratio == 1.0


@pytest.mark.parametrize(
    "loop",
    [
        {"failed_steps": 1},
        {"outcome": "timed_out"},
        {"study": "seas"},
        {"slowdown": 8.0},
        {"scenario": "calm"},
        {"scenario_documents": {"scenario": {"controller": {"kind": "cascade"}}}},
    ],
)
def test_the_stored_ratio_stays_without_a_sound_loop(
    monkeypatch: pytest.MonkeyPatch, loop: dict[str, Any]
) -> None:
    tables = {"replay": _steps(900, 1000), "closed_loop": _steps(900, 2000)}
    found = _compare(monkeypatch, _run("replay"), _run("closed_loop", **loop), tables)
    assert found.loop_ratio == 20.0


def test_the_stored_ratio_stays_where_the_loop_lacks_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tables = {"replay": _steps(900, 1000), "closed_loop": _steps(900, 999)}
    assert _compare(monkeypatch, _run("replay"), _run("closed_loop"), tables).loop_ratio == 20.0

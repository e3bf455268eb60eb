"""Counts of solvers' C beside the times of the same steps on the desk."""

from math import isnan

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.suites.embedded import EmbeddedResults
from tests.conftest import MadeRecords
from tests.embedded.made_counts import make_counts

NATIVE = {"route": "native", "policy": "warm"}


def test_the_desk_is_timed_on_the_counted_steps_alone(records: MadeRecords) -> None:
    """The steps from 50 on are a hundred times as slow, and not among those counted."""
    slow = dict.fromkeys(range(50, 1000), 100.0)
    records.replay("daqp", median_us=10.0, spread=1e-9, slow=slow, **NATIVE)
    (found,) = EmbeddedResults.from_counted_steps(
        records.view(), make_counts("daqp", [1000] * 50, "paper[0:50]")
    ).sequences
    assert found.solvers[0].desk_p99_ns == pytest.approx(10e3, rel=1e-3)
    (later,) = EmbeddedResults.from_counted_steps(
        records.view(), make_counts("daqp", [1000] * 50, "paper[60:110]")
    ).sequences
    assert later.solvers[0].desk_p99_ns == pytest.approx(1e6, rel=1e-3)


def test_a_warm_start_comes_before_a_kept_workspace(records: MadeRecords) -> None:
    for policy, median_us in (("reuse", 5.0), ("warm", 20.0)):
        records.replay("daqp", median_us=median_us, spread=1e-9, route="native", policy=policy)
    (found,) = EmbeddedResults.from_counted_steps(
        records.view(), make_counts("daqp", [1000] * 200)
    ).sequences
    assert found.solvers[0].desk_p99_ns == pytest.approx(20e3, rel=1e-3)


@pytest.mark.parametrize("sequence", ["paper[0:1001]", "calm[0:200]", "paper-30-5"])
def test_without_a_replay_of_these_steps_there_is_no_time(
    records: MadeRecords, sequence: str
) -> None:
    records.replay("daqp", **NATIVE)
    steps = 1001 if sequence.endswith("1001]") else 200
    counts = make_counts("daqp", [1000] * steps, sequence)
    (found,) = EmbeddedResults.from_counted_steps(records.view(), counts).sequences
    assert isnan(found.solvers[0].desk_p99_ns)
    assert found.desk_rank_by_solver == {}


def test_desk_and_counts_disagree_where_both_differ_enough(records: MadeRecords) -> None:
    # p99 on the desk 20, 10 and 10.5 µs; instructions 1000, 2000 and 900.
    times = {"daqp": 20.0, "quadprog": 10.0, "paper_active_set": 10.5}
    for solver, median_us in times.items():
        records.replay(solver, median_us=median_us, spread=1e-9, **NATIVE)
    counts = pd.concat(
        [
            make_counts("daqp", [1000] * 200),
            make_counts("quadprog", [2000] * 200),
            make_counts("paper_active_set", [900] * 200),
        ]
    )
    (found,) = EmbeddedResults.from_counted_steps(records.view(), counts).sequences
    assert [one.solver for one in found.solvers] == ["paper_active_set", "daqp", "quadprog"]
    assert found.desk_rank_by_solver == {"quadprog": 1, "paper_active_set": 2, "daqp": 3}
    pairs = found.find_pairs_ranked_otherwise(1e-2)
    assert [(few.solver, many.solver) for few, many in pairs] == [("daqp", "quadprog")]


def test_a_solver_beyond_the_required_error_is_not_ranked(records: MadeRecords) -> None:
    records.replay("daqp", median_us=20.0, **NATIVE)
    records.replay("osqp", median_us=10.0, **NATIVE)
    loose = make_counts("osqp", [2000] * 200, error=0.5)
    counts = pd.concat([make_counts("daqp", [1000] * 200), loose])
    (found,) = EmbeddedResults.from_counted_steps(records.view(), counts).sequences
    assert found.find_pairs_ranked_otherwise(1e-2) == []
    assert len(found.find_pairs_ranked_otherwise(1.0)) == 1


def test_c_code_at_other_settings_than_the_desk_is_not_ranked(records: MadeRecords) -> None:
    """OSQP's answers depend on its tolerance; an active-set method has none that matters."""
    records.replay("quadprog", median_us=20.0, **NATIVE)
    records.replay("osqp", median_us=10.0, **NATIVE)
    tight = make_counts("osqp", [2000] * 200, settings='{"eps_abs": 1e-06, "rho": 0.25}')
    exact = make_counts("quadprog", [1000] * 200, settings='{"limit": 9}')
    found = EmbeddedResults.from_counted_steps(records.view(), pd.concat([exact, tight]))
    (sequence,) = found.sequences
    assert sequence.find_pairs_ranked_otherwise(1e-2) == []
    assert sequence.desk_rank_by_solver == {"quadprog": 1}
    assert [dict(one.settings) for one in sequence.solvers] == [{}, {"eps_abs": 1e-6, "rho": 0.25}]
    equal = make_counts("osqp", [2000] * 200)
    found = EmbeddedResults.from_counted_steps(records.view(), pd.concat([exact, equal]))
    assert len(found.sequences[0].find_pairs_ranked_otherwise(1e-2)) == 1


def test_the_largest_step_of_a_solver_is_found_over_all_sequences(records: MadeRecords) -> None:
    """Its step k counts from the start of the scenario: 900 + 17."""
    peak = np.full(200, 100)
    peak[17] = 5000
    counts = pd.concat(
        [
            make_counts("daqp", [1000] * 200),
            make_counts("daqp", peak.tolist(), "rough[900:1100]"),
        ]
    )
    results = EmbeddedResults.from_counted_steps(records.view(), counts)
    largest = results.find_largest_count_of_solver("daqp")
    assert largest is not None
    assert (largest[0].sequence, largest[1].worst, largest[1].k) == ("rough[900:1100]", 5000, 917)
    assert results.find_largest_count_of_solver("osqp") is None

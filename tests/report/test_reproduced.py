"""What the report says of the paper follows the rows."""

from typing import Any

import numpy as np
import pytest

from dpbench.report.reproduced import choices, claims


def _states(records: Any) -> dict[str, str]:
    return {claim.claim: claim.state for claim in claims(records.view())}


def _pair(records: Any, scenario: str = "paper", **law: Any) -> None:
    records.loop("daqp", scenario)
    contrast = {"settle_0p1m_s": 64.0, "overshoot_e": 1.13, "heading_max_deg": 0.3}
    records.loop("unconstrained_clipped", scenario, formulation="none", **(contrast | law))


def test_claims_of_the_paper_case(records: Any) -> None:
    """With the numbers of the paper's case all holds but the steady error and the heading."""
    _pair(records)
    _pair(records, "paper_tight", tail_m=9.0, settle_0p1m_s=np.inf)
    failed = [claim for claim, state in _states(records).items() if state != "reproduced"]
    assert failed == [
        "Its steady error is smaller (tuning of `paper`)",
        "Its precision is better in heading too (Fig. 5)",
    ]


@pytest.mark.parametrize(
    ("column", "value", "claim"),
    [
        ("overshoot_e", 0.9, "The constrained law is smoother in the transient: less overshoot"),
        ("settle_0p1m_s", 40.0, "It settles earlier (Fig. 5)"),
    ],
)
def test_rows_that_contradict_are_believed(
    records: Any, column: str, value: float, claim: str
) -> None:
    """When the clipped law is the better one in the rows, the claim is not reproduced."""
    _pair(records, **{column: value})
    assert _states(records)[claim] == "not reproduced"


@pytest.mark.parametrize(
    ("columns", "claim"),
    [
        ({"limit_violations": 1}, "No limit is ever violated (Figs 6, 7)"),
        ({"at_rate_sway": 0.0}, "The rate limits shape the transfer (Fig. 7)"),
        ({"tail_m": 1.2}, "The ship is held within the 1 m precision circle (Fig. 4)"),
        ({"tail_m": 0.06}, "It is nearly stationary there (steady error below 5 cm)"),
    ],
)
def test_claims_on_one_law_follow_its_row(
    records: Any, columns: dict[str, Any], claim: str
) -> None:
    """A claim on the constrained law stands and falls with its row."""
    records.loop("daqp", **columns)
    assert _states(records)[claim] == "not reproduced"


def test_without_the_paper_nothing_is_claimed(records: Any) -> None:
    """Without its closed loops no claim is judged and no choice is listed."""
    records.loop("daqp", "calm")
    assert set(_states(records).values()) == {"not measured"}
    assert choices(records.view()) == []


def test_a_run_cut_short_represents_nobody(records: Any) -> None:
    """The constrained law is shown by a complete run that follows the exact loop closest."""
    records.loop("cut", error=1e-15, done=20, outcome="timed_out")
    records.loop("inexact", error=0.3, tail_m=2.0)
    records.loop("exact", error=1e-12)
    assert _states(records)["The ship is held within the 1 m precision circle (Fig. 4)"] == (
        "reproduced"
    )


def test_choices_are_those_of_the_rows(records: Any) -> None:
    """The weights that are listed as chosen are those the run was made with."""
    _pair(records)
    found = dict(choices(records.view()))
    assert found["Q"].startswith("diag(1, 1, 100)")
    assert found["disturbance, amplitude"].startswith("100, 80, 3000")

"""Position and heading figures of trajectories worked by hand."""

import math

import numpy as np
import pytest

from tests.bench.judge.known_runs import metrics_of, round_ship

DEG = math.pi / 180.0
THREE_DEG = 0.05235987755982988
"""The largest float64 whose value in degrees is 3; π/60 itself is 3.0000000000000004°."""
REFERENCE = [10.0, 5.0, 0.25]
# Errors (3, 4) m, 2°; (0, -2) m, -4°; (-1, 0) m, 1°; none. The end of the last sample counts in
# no figure of this file.
ERRORS = [[3, 4, 2 * DEG], [0, -2, -4 * DEG], [-1, 0, 1 * DEG], [0, 0, 0], [900, 900, 9]]


@pytest.fixture(scope="module")
def known() -> dict[str, float]:
    """Metrics of four samples of 0.5 s about a reference that is not zero."""
    pose = (np.array(ERRORS) + REFERENCE).tolist()
    return metrics_of(pose, reference=[REFERENCE] * 5)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        # d = 5, 2, 1, 0 m: √((25 + 4 + 1 + 0)/4) = √7.5
        ("r_rms_m", 2.7386127875258306),
        ("r_max_m", 5.0),
        # Of 0, 1, 2, 5 the rank 0.95·3 = 2.85: 2 + 0.85·(5 − 2)
        ("r_95_m", 4.55),
        # Samples 2 and 3 of 0 … 3
        ("r_tail_max_m", 1.0),
        # 2, 4, 1, 0°: √((4 + 16 + 1 + 0)/4) = √5.25
        ("heading_rms_deg", 2.2912878474779200),
        ("heading_max_deg", 4.0),
        # (3 + 0 + 1 + 0)·0.5, (4 + 2)·0.5, 7°·0.5 = 3.5° in rad
        ("iae_n", 2.0),
        ("iae_e", 3.0),
        ("iae_psi", 0.061086523819801536),
        # (9 + 0 + 1)·0.5, (16 + 4)·0.5, (4 + 16 + 1)·0.5 = 10.5 deg² in rad²
        ("ise_n", 5.0),
        ("ise_e", 10.0),
        ("ise_psi", 0.00319848290776044),
        # t = 0, 0.5, 1, 1.5 s: 1·1·0.5, 0.5·2·0.5, (0.5·4° + 1·1°)·0.5 = 1.5° in rad
        ("itae_n", 0.5),
        ("itae_e", 0.5),
        ("itae_psi", 0.026179938779914941),
        # From +3 to -1, from +4 to -2, from +2° to -4°
        ("overshoot_n", 1.0),
        ("overshoot_e", 2.0),
        ("overshoot_psi", 0.069813170079773182),
        # d ≤ 1 m at samples 2 and 3
        ("share_1m", 0.5),
    ],
)
def test_errors_of_a_known_run(name: str, value: float, known: dict[str, float]) -> None:
    assert known[name] == pytest.approx(value, rel=1e-12)


def test_the_error_is_that_from_the_reference_of_its_own_sample() -> None:
    moving = [[0, 0, 0], [1, -2, 0.1], [3, -5, 0.2], [7, -9, 0.4]]
    found = metrics_of(moving, reference=moving)
    assert found["r_max_m"] == found["heading_max_deg"] == found["iae_n"] == 0.0
    late = metrics_of([moving[0], *moving[:3]], reference=moving)
    # One sample behind: 0, (-1, 2), (-2, 3) m and 0, -0.1, -0.1 rad.
    assert late["r_max_m"] == pytest.approx(math.sqrt(13.0))
    assert late["iae_n"] == pytest.approx((1.0 + 2.0) * 0.5)
    assert late["heading_max_deg"] == pytest.approx(0.1 / DEG)


def test_the_tail_is_the_second_half_with_the_middle_sample() -> None:
    found = metrics_of([[d, 0, 0] for d in (9, 8, 7, 1, 2, 50)])
    assert found["r_tail_max_m"] == 7.0


@pytest.mark.parametrize(
    ("errors", "overshoot"),
    [
        ([2.0, 1.0, 0.5], 0.0),
        ([-1.0, 0.5, 0.25], 0.5),
        ([-1.0, -3.0, 0.0], 0.0),
        ([1.0, -0.25, -0.75], 0.75),
    ],
)
def test_overshoot_is_the_excursion_beyond(errors: list[float], overshoot: float) -> None:
    found = metrics_of([[e, e, e] for e in (*errors, 0.0)])
    for axis in ("n", "e", "psi"):
        assert found[f"overshoot_{axis}"] == pytest.approx(overshoot)


def test_from_the_reference_there_is_no_overshoot() -> None:
    found = metrics_of([[0, 1, 0.1], [5, -2, 0.2], [0, 0, 0]])
    assert math.isnan(found["overshoot_n"])
    assert found["overshoot_e"] == 2.0
    assert found["overshoot_psi"] == 0.0


HELD = 60
"""Number of samples of 0.5 s in 30 s."""


@pytest.mark.parametrize(
    ("inside", "settled_s"),
    [
        ([1.0, 0.0, 1 * DEG], 1.5),
        ([0.6, 0.8, -1 * DEG], 1.5),
        ([1.0 + 1e-9, 0.0, 0.0], math.inf),
        ([0.0, 0.0, 1.000001 * DEG], math.inf),
    ],
)
def test_settling_includes_its_limits(inside: list[float], settled_s: float) -> None:
    """An error of exactly 1 m or 1° is settled, a slightly larger one is not."""
    found = metrics_of([[2, 0, 0]] * 3 + [inside] * (HELD + 1))
    assert found["settle_s"] == settled_s


def test_settling_needs_thirty_seconds() -> None:
    """A hold one sample shorter than 30 s does not count, and an excursion restarts it."""
    out, inside = [0, 2, 0], [0, 0.5, 0]
    short = metrics_of([out] * 3 + [inside] * (HELD - 1) + [out] * 2)
    assert short["settle_s"] == math.inf
    again = metrics_of([out] * 3 + [inside] * (HELD - 1) + [out] + [inside] * (HELD + 1))
    # 3 + 59 + 1 samples before
    assert again["settle_s"] == 31.5
    left = metrics_of([out] * 3 + [inside] * HELD + [out] * 9)
    assert left["settle_s"] == 1.5
    assert metrics_of([inside] * (HELD + 1))["settle_s"] == 0.0
    assert metrics_of([inside] * HELD)["settle_s"] == math.inf


def test_thirty_seconds_are_as_many_samples_as_fit() -> None:
    """The hold is 100 samples of 0.3 s, or a single sample of 100 s."""
    out, inside = [0, 2, 0], [0, 0.5, 0]
    paper = round_ship(0.3)
    for held, settled_s in ((100, 0.3), (99, math.inf)):
        found = metrics_of([out, *[inside] * held, out], scenario=paper)
        assert found["settle_s"] == pytest.approx(settled_s)
    slow = metrics_of([out, out, inside, out, out], scenario=round_ship(100.0))
    assert slow["settle_s"] == 200.0


@pytest.mark.parametrize(
    ("radii", "settled_s"),
    [
        ([1.0, 0.1, 0.2, 0.1, 0.05], 1.5),
        ([0.1, 0.05, 0.1, 0.0], 0.0),
        ([1.0, 0.05, 0.05, 0.11], math.inf),
        ([1.0, 1.0, 1.0, 0.1], 1.5),
    ],
)
def test_settling_within_a_decimetre_lasts_to_the_end(radii: list[float], settled_s: float) -> None:
    """An error of exactly 0.1 m is settled, whatever the heading."""
    found = metrics_of([[0, r, 0.5] for r in (*radii, 7.0)])
    assert found["settle_0p1m_s"] == settled_s


ZONES = [
    ([3.0, 0.0, THREE_DEG], "green"),
    ([0.0, -3.0, -THREE_DEG], "green"),
    ([3.0 + 1e-9, 0.0, 0.0], "yellow"),
    ([0.0, 0.0, 3.000001 * DEG], "yellow"),
    ([0.0, 5.0, 5 * DEG], "yellow"),
    ([-3.0, -4.0, -5 * DEG], "yellow"),
    ([5.0 + 1e-9, 0.0, 0.0], "red"),
    ([0.0, 0.0, 5.000001 * DEG], "red"),
    ([0.0, 0.0, -0.5], "red"),
]


@pytest.mark.parametrize(("error", "zone"), ZONES)
def test_zones_include_their_limits(error: list[float], zone: str) -> None:
    """3 m and 3° are still green, 5 m and 5° still yellow."""
    found = metrics_of([error, [0, 0, 0]])
    shares = {name: found[f"share_{name}"] for name in ("green", "yellow", "red")}
    assert shares == {"green": 0.0, "yellow": 0.0, "red": 0.0} | {zone: 1.0}


def test_shares_of_zones_and_of_the_circle_of_one_metre() -> None:
    """Two of five samples are green, two yellow, one red; one is within 1 m."""
    found = metrics_of([[d, 0, 0] for d in (1, 2, 4, 5, 6, 0)])
    assert (found["share_green"], found["share_yellow"], found["share_red"]) == (0.4, 0.4, 0.2)
    assert found["share_1m"] == 0.2
    # The share of the circle regards the position alone.
    assert metrics_of([[1, 0, 3], [1.1, 0, 0], [0, 0, 0]])["share_1m"] == 0.5


def test_pose_error_weighs_the_heading_less_the_further_away() -> None:
    """The mean of 0 + 0.4, 1 + 0.75·0.4 and 2 + 0.5625·0.8 is 4.15/3, headings in radians."""
    found = metrics_of([[0, 0, 0.4], [0, 1, -0.4], [-2, 0, -0.8], [0, 0, 0]])
    assert found["pose_error"] == pytest.approx(4.15 / 3)

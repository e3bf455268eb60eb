"""The worked example of a study's interval in the method, recomputed by plain NumPy."""

import re

import numpy as np
import pytest
from scipy import stats

from dpbench.analysis.suites.study import estimate_mean_over_points
from tests.docs.markdown_blocks import DOCS

METHOD = (DOCS / "method.md").read_text(encoding="utf-8")
EXAMPLE = METHOD.split("Example: twelve")[1].split("\n### ")[0]
DIFFERENCES = np.array(re.findall(r"[\d.]+", EXAMPLE.split("d    = ")[1].splitlines()[0]), float)


def _documented(name: str) -> float:
    """The number at the end of the equations that begin with a name."""
    line = EXAMPLE.split(f"{name} = ")[1].splitlines()[0].split("      ")[0]
    return float(line.split("= ")[-1].split(" ")[0].replace("−", "-"))


def _end(skew: float, quantile: float) -> float:
    """Hall's inverse, found as the root of his cubic and not by its formula."""
    roots = np.roots([skew**2 / 27, skew / 3, 1.0, skew / 6 - quantile])
    return float(roots[np.abs(roots.imag) < 1e-9].real.item())


def test_the_example_is_what_numpy_finds() -> None:
    assert len(DIFFERENCES) == 12
    mean, error = DIFFERENCES.mean(), stats.sem(DIFFERENCES)
    g = stats.skew(DIFFERENCES, bias=False) / np.sqrt(12)
    t = stats.t.ppf(0.975, 11)
    found = {"e   ": error, "t": t, "g   ": g, "s": 1.5 * g, "h(t)": _end(1.5 * g, t)}
    found |= {"h(−t)": _end(1.5 * g, -t), "low": mean - error * t}
    found |= {"high": mean - error * _end(1.5 * g, -t)}
    assert {name: _documented(name) for name in found} == pytest.approx(found, abs=1e-4)
    student, hall = re.findall(r"[\d.]+\d", EXAMPLE.split("Student's interval")[1])[1:]
    assert float(student) == pytest.approx(mean + error * t, abs=1e-4)
    assert float(hall) == pytest.approx(mean - error * _end(g, -t), abs=1e-4)


def test_the_program_states_the_documented_interval() -> None:
    found = estimate_mean_over_points(DIFFERENCES[None]).confidence_interval
    documented = (_documented("m   "), _documented("low"), _documented("high"))
    assert (found.value, found.low, found.high) == pytest.approx(documented, abs=1e-4)


def test_the_largest_reach_is_what_the_method_says() -> None:
    """The skewness of an estimate is at most that of one value far from all others."""
    for count, reach in ((6, 10.6), (12, 9.1), (30, 8.5)):
        assert re.search(rf"{reach} e (from the mean\s+)?with\s+{count}\b", METHOD)
        single = estimate_mean_over_points(np.eye(count)[:1])
        assert single.skew == pytest.approx(1.0)
        quantile = stats.t.ppf(0.975, count - 1)
        reaches = [-_end(s, -quantile) for s in np.linspace(0.01, 1.5, 1000)]
        assert max(reaches) == pytest.approx(reach, abs=0.05)

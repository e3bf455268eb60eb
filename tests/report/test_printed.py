"""Figures by Matplotlib show the tables that the page's figures show."""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.suites.paper import Law
from dpbench.analysis.times.solver_tables import TIMES
from dpbench.report.charts.ship_tables import make_error_panels, make_force_panels, make_path_tables
from dpbench.scenario.scenario import load_scenario

to_rgb = pytest.importorskip("matplotlib.colors", reason="an extra").to_rgb

STEPS = 40
SCENARIO = load_scenario("paper")


def _law(label: str, amplitude: float) -> Law:
    """A ship that goes to and fro, and forces to and fro."""
    t = 0.3 * np.arange(STEPS)
    wave = amplitude * np.sin(t)
    columns = {"n_m": wave, "e_m": wave / 2, "psi_rad": wave / 100, "t_s": t}
    return Law(label, pd.DataFrame(columns | dict.fromkeys(FORCES, 100000.0 * wave)))


FORCES = ("tau_x_N", "tau_y_N", "tau_n_Nm")
LAWS = [_law("daqp", 2.0), _law("clipped", 3.0)]


def _printed() -> Any:
    from dpbench.report.charts import printed

    return printed


def _legend(figure: Any) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_the_path_has_a_line_for_each_law_and_equal_axes() -> None:
    figure = _printed().draw_path(make_path_tables(LAWS, SCENARIO))
    (axes,) = figure.axes
    by_label = {line.get_label(): line for line in axes.lines}
    assert _legend(figure) == ["daqp", "clipped", "start", "reference"]
    np.testing.assert_array_equal(by_label["clipped"].get_ydata(), LAWS[1].steps["n_m"])
    assert [line[0] for line in by_label["start"].get_data()] == [1.3, 1.2]
    assert np.ptp(axes.get_xlim()) == pytest.approx(np.ptp(axes.get_ylim()))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("east [m]", "north [m]")


def test_errors_have_four_panels_and_the_circle_in_the_last() -> None:
    figure = _printed().draw_panels(make_error_panels(LAWS, SCENARIO))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["north [m]", "east [m]", "heading [°]", "radial [m]"]
    assert [len(axes.lines) for axes in figure.axes] == [2, 2, 2, 3]
    radial = figure.axes[-1]
    assert radial.get_yscale() == "log" and radial.lines[-1].get_ydata()[0] == 1.0
    assert radial.lines[0].get_ydata().min() == 1e-6  # at the start the error is 0
    heading = figure.axes[2].lines[1].get_ydata()
    np.testing.assert_allclose(heading, np.rad2deg(LAWS[1].steps["psi_rad"]))


def test_limits_of_forces_are_drawn_or_named() -> None:
    figure = _printed().draw_panels(make_force_panels(LAWS, SCENARIO))
    surge, sway, yaw = figure.axes
    notes = [axes.texts[0].get_text() for axes in figure.axes]
    assert (len(surge.lines), len(sway.lines), len(yaw.lines)) == (2, 4, 2)
    limits = [line.get_ydata()[0] for line in sway.lines[2:]]
    vessel = SCENARIO.vessel
    assert limits == pytest.approx([vessel.tau_min[1] / 1e3, vessel.tau_max[1] / 1e3])
    # The paper's ship has 980 kN astern and 1240 kN ahead.
    assert notes[0] == "limits −980 to +1240" and notes[1] == ""
    assert notes[2].startswith("limits ±")
    assert surge.lines[0].get_ydata() == pytest.approx(LAWS[0].steps["tau_x_N"] / 1e3)


def _steps() -> pd.DataFrame:
    k = np.arange(6)
    failed = k == 4
    error = np.where(failed, 0.5, 1e-6)
    error[0] = 0.0
    columns = {"k": k, "time_us": 10.0 + k, "raw_us": 20.0 + k, "error": error}
    return pd.DataFrame(columns | {"iterations": 3, "active": k % 2, "failed": failed})


def test_steps_have_their_failures_apart_and_the_limit() -> None:
    shares = pd.DataFrame({"k": [0, 1], "force": "sway", "share": [0.5, -0.5]})
    draw = _printed().draw_step_strips
    times, errors, iterations, forces = draw(_steps(), shares, 0.01).axes
    assert times.lines[0].get_ydata().tolist() == [10, 11, 12, 13, 14, 15]
    assert [len(line.get_xdata()) for line in errors.lines[:2]] == [5, 1]
    assert errors.lines[1].get_ydata().tolist() == [0.5]
    assert errors.lines[0].get_ydata().min() == 1e-16
    assert errors.lines[2].get_ydata()[0] == 0.01
    assert iterations.lines[0].get_ydata().tolist() == 6 * [3]
    assert forces.get_ylim() == (-1.05, 1.05)
    assert len(draw(_steps(), None, 0.01).axes) == 3  # of a replay


def test_times_stand_against_limit_and_deadline() -> None:
    numbers = {"p50_ms": [0.01, 1.0], "limiting_p99_ms": [0.02, np.nan], "max_ms": [0.05, 9.0]}
    columns = {"label": ["daqp", "osqp"], "verdict": ["pass", "late"], "longest_ms": [0.1, 20.0]}
    table = pd.DataFrame(numbers | columns).reindex(columns=list(TIMES))
    figure = _printed().draw_deadline_chart(table, 300.0, 3.0)
    (axes,) = figure.axes
    assert axes.get_xscale() == "log" and axes.yaxis_inverted()
    assert [text.get_text() for text in axes.get_yticklabels()] == ["daqp", "osqp"]
    limits, spans = ["p99 limit", "deadline"], ["p50 to limiting p99", "to the longest step"]
    spans += ["to the largest single timing"]
    assert _legend(figure) == [*limits, "p50, pass", "p50, late", *spans]
    by_label = {line.get_label(): line for line in axes.lines}
    assert by_label["deadline"].get_xdata()[0] == 300.0
    bars = [line.get_segments()[0][:, 0].tolist() for line in axes.collections]
    assert bars[:3] == [[0.05, 0.1], [0.01, 0.05], [0.01, 0.02]]
    assert bars[5] == [1.0, 1.0]  # without a p99 the bar has no length


def test_accuracy_has_shapes_of_settings_and_fills_of_verdicts() -> None:
    """As in the figure of the page: circles and squares, hollow for late or fail."""
    columns = {"solver": ["osqp", "osqp", "daqp"], "error": [0.1, 1e-5, 0.0]}
    columns |= {"family": ["first order", "first order", "active set"], "p50_us": [20.0, 60.0, 5.0]}
    columns |= {"verdict": ["fail", "inconclusive", "pass"]}
    table = pd.DataFrame(columns | {"settings": ["default", "high", "default"]})
    figure = _printed().draw_accuracy(table, 0.01)
    (axes,) = figure.axes
    low, high, daqp = axes.collections
    hollow, pale, filled = (of.get_facecolors()[0, :3].tolist() for of in (low, high, daqp))
    assert hollow == [1.0, 1.0, 1.0] and filled == pytest.approx(to_rgb("#0072b2"), abs=0.06)
    assert pale == pytest.approx([0.7, 0.7 + 0.3 * 158 / 255, 0.7 + 0.3 * 115 / 255])
    corners = [len(of.get_paths()[0].vertices) for of in (low, high, daqp)]
    assert corners[0] == corners[2] > corners[1] == 5
    assert daqp.get_offsets().tolist() == [[5.0, 1e-16]]
    assert [text.get_text() for text in axes.texts] == ["osqp", "daqp"]
    assert axes.texts[0].xy == (60.0, 1e-5)
    states = ["pass", "borderline", "inconclusive", "late or fail"]
    verdicts = [f"verdict {state}" for state in states]
    assert _legend(figure) == ["active set", "first order", "default", "high", *verdicts]
    (legend,) = figure.legends
    markers = [line.get_marker() for line in legend.get_lines()]
    assert markers == ["o", "o", "o", "s", "o", "o", "o", "o"]
    assert legend.get_lines()[-1].get_markerfacecolor() == "#ffffff"
    assert axes.get_xlabel() == "p50 of the step time [µs]"


def test_labels_of_a_short_logarithmic_axis_stand_apart() -> None:
    """From 40 to 70 µs, where each of nine ticks would have a label."""
    columns = {"solver": ["osqp", "daqp"], "error": [1e-5, 1e-6], "p50_us": [70.0, 40.0]}
    columns |= {"family": ["first order", "active set"], "verdict": ["pass", "pass"]}
    columns["settings"] = ["default", "default"]
    figure = _printed().draw_accuracy(pd.DataFrame(columns), 0.01)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    labels = [*axes.xaxis.get_majorticklabels(), *axes.xaxis.get_minorticklabels()]
    boxes = [label.get_window_extent() for label in labels if label.get_text()]
    low, high = axes.get_window_extent().intervalx
    inside = sorted(box.intervalx.tolist() for box in boxes if low <= box.intervalx.mean() <= high)
    assert inside
    assert all(end < start for (_, end), (start, _) in pairwise(inside))


@pytest.mark.slow
def test_a_notebook_gets_a_picture() -> None:
    figure = _printed().draw_panels(make_error_panels(LAWS, SCENARIO))
    assert figure._repr_png_().startswith(b"\x89PNG")

"""Cells of LaTeX against cells that were written by hand."""

import math

import pandas as pd
import pytest

from dpbench.notebook.latex import escape_latex, format_latex_cell, make_table_head, make_tabular


@pytest.mark.parametrize(
    ("value", "cell"),
    [
        (1.2e-12, r"$1.20\cdot 10^{-12}$"),
        (-3.456e-7, r"$-3.46\cdot 10^{-7}$"),
        (1e-10, r"$1.00\cdot 10^{-10}$"),
        (2.5e9, r"$2.50\cdot 10^{9}$"),
        (8326.389, "8330"),
        (0.000615, "0.000615"),
        (9.9999e-5, "0.000100"),
        (0.0, "0"),
        (-0.25, "$-0.250$"),
        (2.0, "2.00"),
        (9.999, "10.0"),
        (100.0, "100"),
        (math.inf, r"$\infty$"),
        (-math.inf, r"$-\infty$"),
        (math.nan, ""),
        (pd.NA, ""),
        (None, ""),
        (6035, "6035"),
        (-3, "$-$3"),
        (True, "True"),
    ],
)
def test_a_value_is_a_cell(value: object, cell: str) -> None:
    assert format_latex_cell(value) == cell


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("p99_us", r"p99\_us"),
        ("A & B, 5 % of #1 in {x}", r"A \& B, 5 \% of \#1 in \{x\}"),
        ("C:\\x ~ y^2", r"C:\textbackslash{}x \textasciitilde{} y\textasciicircum{}2"),
        ("largest |λ| ≥ 64", r"largest $|$$\lambda$$|$ $\ge$ 64"),
        ("1.68 – 1.75 m·s⁻²", r"1.68 -- 1.75 m$\cdot$s$^{-}$$^{2}$"),
        ("a → b, up to ∞", r"a $\to$ b, up to $\infty$"),
        ("eps_abs=1e-05,rho=-0.1", r"eps\_abs=$10^{-5}$,rho=$-$0.1"),
        ("paper-30-5, k 3, 1\u202f741 rounds", r"paper-30-5, k 3, 1\,741 rounds"),
        ("−3 °C in `turn`", r"$-$3 $^{\circ}$C in turn"),
        ("v1e5x 2a", "v1e5x 2a"),
    ],
)
def test_a_text_is_escaped(text: str, latex: str) -> None:
    assert escape_latex(text) == latex


def test_numbers_are_to_the_right_of_a_table() -> None:
    table = pd.DataFrame({"a_b": ["x"], "n": [2], "is": [True], "t": [0.5]})
    lines = make_tabular(table).splitlines()
    assert lines[0] == r"\begin{tabular}{lrlr}" and lines[2] == r"a b & n & is & t \\"
    assert lines[4] == r"x & 2 & True & 0.500 \\" and lines[-1] == r"\end{tabular}"


def test_a_column_of_whole_numbers_has_no_decimals() -> None:
    """Counts with gaps are floats; measured values keep their zeros."""
    table = pd.DataFrame({"steps": [1000.0, float("nan")], "p50_us": [5.0, 4.25]})
    rows = make_tabular(table).splitlines()[4:6]
    assert rows == [r"1000 & 5.00 \\", r" & 4.25 \\"]


def test_speed_margins_are_rounded_down() -> None:
    table = pd.DataFrame(
        {"margin": [45.79, 2.999], "margin_p99": [0.88999, 30.0], "p50_us": [45.79, 1]}
    )
    rows = make_tabular(table).splitlines()[4:6]
    assert rows == [r"45.7 & 0.889 & 45.8 \\", r"2.99 & 30.0 & 1.00 \\"]


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("excess_error_cm_low", "excess error, low [cm]"),
        ("excess_cost_percent", "excess cost [%]"),
        ("realisations_for_1_cm", "realisations for 1 cm"),
        ("p_differs", "p-value"),
        ("x_environment.wind.speed_mps", "environment.wind.speed [m/s]"),
        ("x_start.east_m", "start.east [m]"),
        ("x_eps_abs", "eps_abs"),
        ("r_95_m", "r 95 [m]"),
        ("low", "low"),
        ("tau_x_N", "tau x [N]"),
        ("median step time [%]", "median step time [%]"),
    ],
)
def test_a_head_has_its_unit_at_the_end(name: str, head: str) -> None:
    assert make_table_head(name) == head


def test_a_column_has_one_notation_and_an_option_that_of_its_settings() -> None:
    table = pd.DataFrame({"x_rho": [0.1, 1e-6], "error": [3.28e-4, 9.55e-15]})
    rows = [line for line in make_tabular(table).splitlines() if "cdot" in line]
    assert rows == [
        r"$10^{-1}$ & $3.28\cdot 10^{-4}$ \\",
        r"$10^{-6}$ & $9.55\cdot 10^{-15}$ \\",
    ]
    table = pd.DataFrame({"x_rho": [0.1, 1.6], "error": [3.28e-4, 0.5]})
    assert make_tabular(table).splitlines()[4:6] == [r"0.1 & 0.000328 \\", r"1.6 & 0.500 \\"]


@pytest.mark.parametrize("names", [("cost_cm", "cost_cm_low"), ("effect [cm]", "high [cm]")])
def test_an_estimate_and_its_interval_have_one_notation(names: tuple[str, str]) -> None:
    """Other columns of the table keep theirs."""
    table = pd.DataFrame({names[0]: [2e-5], names[1]: [0.25], "p50_us": [0.25]})
    row = make_tabular(table).splitlines()[4]
    assert row == r"$2.00\cdot 10^{-5}$ & $2.50\cdot 10^{-1}$ & 0.250 \\"


@pytest.mark.parametrize(
    ("names", "bounds"),
    [
        (("effect [cm]", "low [cm]", "high [cm]"), "299.3 & 298.9 & 299.4"),
        (("ratio", "low", "high"), "299.3 & 298.9 & 299.4"),
        (("error_cm", "error_cm_low", "error_cm_high"), "299.3 & 298.9 & 299.4"),
        (("error_cm", "low", "high"), "299 & 299 & 299"),
    ],
)
def test_an_interval_keeps_its_width(names: tuple[str, str, str], bounds: str) -> None:
    """By a fourth digit, in its row and for its estimate alone."""
    rows = [[299.31, 298.87, 299.42, 299.31], [274.12, 253.4, 285.1, 1.0]]
    table = pd.DataFrame(rows, columns=[*names, "median"])
    assert make_tabular(table).splitlines()[4:6] == [
        rf"{bounds} & 299 \\",
        r"274 & 253 & 285 & 1.00 \\",
    ]


def test_columns_of_long_texts_share_the_line() -> None:
    """Short texts and numbers keep their columns; a narrow width holds the longest word."""
    table = pd.DataFrame({"a": ["word " * 7], "b": ["word " * 14], "c": ["short"], "n": [1.5]})
    types = make_tabular(table).splitlines()[0]
    assert types == r"\begin{tabular}{p{0.25\linewidth}p{0.51\linewidth}lr}"
    many = pd.DataFrame({name: ["word " * 7, "x" * 40] for name in "abcde"})
    assert make_tabular(many).splitlines()[0].count(r"p{0.20\linewidth}") == 5
    table = pd.DataFrame({"a": ["x" * 20 + " and more text"], "b": ["word " * 100]})
    assert r"{p{0.25\linewidth}p{0.67\linewidth}}" in make_tabular(table)

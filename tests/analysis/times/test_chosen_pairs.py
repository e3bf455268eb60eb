"""Step time ratios of chosen configurations, whatever their verdicts."""

from pathlib import Path
from typing import Any

import pytest

from dpbench import InputError
from dpbench.analysis.times.chosen_pairs import compare_chosen, select_timed_configurations
from dpbench.cli.main import main
from dpbench.errors import UnknownNameError
from dpbench.report.compare.chosen import compare_configurations_of_folder

EXACT = {"spread": 0.0, "rounds": 1, "steps": 40}
OWN = {
    name: {"settings": name, "options": f'{{"rho": {rho}}}'}
    for name, rho in (("rho=1.6", "1.6"), ("mine", "0.1"))
}


def _fill(records: Any) -> None:
    """Two own settings that fail, a preset, and another solver in another call mode too."""
    records.replay("osqp", median_us=40.0, **EXACT)
    records.replay("osqp", median_us=30.0, settings="high", **EXACT)
    records.replay("osqp", median_us=20.0, error=0.5, **EXACT, **OWN["rho=1.6"])
    records.replay("osqp", median_us=60.0, error=0.5, **EXACT, **OWN["mine"])
    records.replay("daqp", median_us=10.0, **EXACT)
    records.replay("daqp", median_us=5.0, route="native", **EXACT)


@pytest.mark.parametrize(
    ("choices", "ratios"),
    [
        (["osqp[rho=1.6]", "osqp mine"], [3.0]),
        (["osqp[rho=[1.6,0.1]]"], [3.0]),
        (["osqp[rho=1.6]", "daqp"], [0.5]),
        (["daqp", "osqp", "osqp high"], [4.0, 3.0, 0.75]),
        (["daqp (native fresh)", "osqp[rho=0.1]"], [12.0]),
    ],
)
def test_any_two_have_a_ratio_in_one_call_mode_where_they_share_one(
    choices: list[str], ratios: list[float], records: Any
) -> None:
    _fill(records)
    found = compare_chosen(records.view(), choices)
    assert [one.ratio.value for one in found] == pytest.approx(ratios)


@pytest.mark.parametrize(
    "name", ["osqp grid[rho=2]", "osqp grid[rho=2] (qpsolvers fresh)", "osqp (qpsolvers fresh, {})"]
)
def test_a_point_of_a_grid_of_a_suite_is_found_by_its_printed_names(
    name: str, records: Any
) -> None:
    """Its settings have brackets of their own."""
    grid = "grid[rho=2]"
    records.replay("osqp", settings=grid, options='{"rho": 2}', **EXACT)
    records.replay("osqp", **EXACT)
    (found,) = select_timed_configurations(records.view(), name.format(grid))
    assert found.settings == grid


def test_a_solver_alone_is_its_default_settings_or_the_first_that_were_timed(records: Any) -> None:
    records.replay("osqp", settings="mid", **EXACT)
    records.replay("osqp", settings="low", **EXACT)
    (found,) = select_timed_configurations(records.view(), "osqp")
    assert found.settings == "low"


@pytest.mark.parametrize(
    ("choices", "fault"),
    [
        (
            ["osqp", "scs"],
            "'scs', which was not timed; .* a solver that was timed: one of osqp, 'osqp high'",
        ),
        (["osqp", "osqp[rho=7]"], r"found 'osqp\[rho=7\]'"),
        (["osqp"], "`choices`: found osqp alone; allowed: two or more, such as daqp, 'osqp high'"),
        (
            ["osqp[high]"],
            r"`choices`: found 'osqp\[high\]', which was not timed; .*: one of osqp, 'osqp high'",
        ),
        (["osqp", "osqp[rho="], "allowed: names with TOML values"),
    ],
)
def test_a_choice_that_was_not_timed_is_refused(
    choices: list[str], fault: str, records: Any
) -> None:
    _fill(records)
    with pytest.raises(InputError, match=fault):
        compare_chosen(records.view(), choices)
    with pytest.raises(UnknownNameError, match="results with timed replays"):
        select_timed_configurations(type(records)().view(), "osqp")


def test_the_command_prints_ratios_with_verdicts(
    records: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _fill(records)
    records.loop("daqp")
    out = records.write(tmp_path / "out")
    words = ["--solver", "osqp[rho=1.6]", "--solver", "daqp"]
    assert main(["compare", str(out), *words, "--markdown", "-"]) == 0
    said = capsys.readouterr().out
    assert (
        "daqp (qpsolvers fresh) against osqp (qpsolvers fresh, rho=1.6) at 30 variables: 0.500"
        in said
    )
    errors = "1.0e-09 (daqp (qpsolvers fresh)) and 0.50 (osqp (qpsolvers fresh, rho=1.6))"
    listed = f"Largest errors over all runs, in maximum increments: {errors}."
    assert listed in " ".join(said.split())
    assert "Verdict on osqp (qpsolvers fresh, rho=1.6): fail." in said
    assert "0.500 times as long over the same steps in the replay of " in said
    assert "- Machine: " in said and "- Versions: osqp 1.0, daqp 1.0; suite " in said
    compared = compare_configurations_of_folder(out, ["osqp", "daqp"])
    times = [head for head in compared.table.heads if head.endswith("[µs]")]
    assert times == ["first, geometric mean [µs]", "second, geometric mean [µs]"]
    (row,) = compared.ratios.to_dict("records")
    assert (row["ratio"], row["first_us"]) == (pytest.approx(0.25), pytest.approx(40.0))
    assert main(["compare", str(out), str(out), *words, "--html", "c.html"]) == 2
    assert capsys.readouterr().err.startswith(
        "dpbench: --solver: found with 2 folders and --html; allowed: --solver with one "
        "folder, and without --html or --reference"
    )

"""A plant that fails, crashes or hangs is its own fault, in the solver's loop and the reference."""

from pathlib import Path

import pytest

from dpbench import load_results, run_campaign
from tests.bench.deterministic import suite_file, suite_toml
from tests.scenario.plants.fmus import FAULTS, build_ship_fmu, needs_fmi, write_scenario

pytestmark = [needs_fmi, pytest.mark.slow]
STEPS = 12


def run_with(
    folder: Path, solvers: list[str], fault: str = "", counter: str = ""
) -> "list[tuple[str, str, int]]":
    """Outcome, its detail and steps of the closed loops of solvers with an FMU."""
    path = write_scenario(folder, build_ship_fmu(folder, 2, counter=counter).name)
    if fault:
        with path.open("a") as file:
            file.write(f"fault = {FAULTS[fault]}.0\nfault_s = 1.5\n")
    loops = [{"scenarios": ["case.toml"], "steps": STEPS, "settings": ["default"]}]
    text = suite_toml(solvers=solvers, closed_loop=loops, cell_limit_s=2.0)
    suite = suite_file(folder, text)
    runs = load_results(run_campaign(suite, folder / "out")).runs
    runs = runs[runs["mode"] == "closed_loop"]
    return list(zip(runs["outcome"], runs["outcome_detail"], runs["steps_done"], strict=True))


def test_every_solver_steers_an_fmu_of_its_own(tmp_path: Path) -> None:
    runs = run_with(tmp_path, ["daqp", "quadprog"])
    assert len(runs) >= 2
    assert {(outcome, steps) for outcome, _, steps in runs} == {("finished", STEPS)}


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("error", "plant ship2.fmu: the FMU returned 'error' from DoStep at t = 1.5 s"),
        ("crash", "plant ship2.fmu failed, not the solver: killed by SIGABRT"),
        ("hang", "plant ship2.fmu failed, not the solver: one call ran beyond the limit"),
    ],
)
@pytest.mark.parametrize("in_reference", [False, True])
def test_a_fault_of_the_plant_is_charged_to_no_solver(
    fault: str, words: str, in_reference: bool, tmp_path: Path
) -> None:
    counter = "" if in_reference else str(tmp_path / "counter")
    runs = run_with(tmp_path, ["quadprog"], fault, counter)
    assert runs
    for outcome, detail, steps in runs:
        assert (outcome, steps) == ("invalid", 0)
        assert words in detail
        assert ("reference loop failed" in detail) == in_reference

"""The generated C controller steers the ship as the Python loop does, or is refused."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import osqp
import pytest
import scipy

from dpbench import record_sequence
from dpbench.cli.main import main
from dpbench.codegen.controller_data import (
    ControllerData,
    make_unique_c_identifiers,
    read_controller_data_of_scenario,
    record_closed_loop_trajectory,
)
from dpbench.codegen.generate import generate_controller
from dpbench.codegen.solver_sources import generate_c_sources_of_osqp
from dpbench.errors import InputError, SituationError
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.contract import Settings
from tests.codegen.c_controller import WARNINGS, CController, compile_c, needs_gcc, steer

STEPS = 1000


def _generate(name: str, folder: Path, steps: int = 3) -> ControllerData:
    generate_controller(name, out=folder, steps=steps, counts=False)
    return read_controller_data_of_scenario(load_scenario(name))


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["paper", "rough", "thruster_loss", "thruster_loss_hard", "thrusters", "thrusters_loss"],
)
def test_the_c_controller_steers_as_the_python_loop(name: str, tmp_path: Path) -> None:
    """1000 steps in closed loop with the simulated ship, faults included."""
    data = _generate(name, tmp_path)
    expected = record_closed_loop_trajectory(data, "paper_active_set", STEPS).commands
    controller = CController(tmp_path, data, np.zeros(len(data.du_max)))
    commands = steer(data, controller, len(expected))
    assert np.abs((commands - expected) / data.du_max).max() < 1e-9
    assert np.abs(np.diff(expected, axis=0) / data.du_max).max() > 0.1


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver"),
    [
        # Between them these execute every line that other scenarios do.
        ("thruster_loss", "paper_active_set"),
        ("thruster_loss_hard", "paper_active_set"),
        ("thrusters_loss", "paper_active_set"),
        ("thruster_loss", "osqp"),
        ("rough", "daqp"),
    ],
)
def test_a_sanitizer_finds_nothing_in_a_replay(name: str, solver: str, tmp_path: Path) -> None:
    """The example replays its trajectory under the address and undefined-behaviour sanitizers."""
    try:
        written = generate_controller(name, solver, out=tmp_path, steps=STEPS, counts=False)
    except SituationError as error:
        pytest.skip(str(error))  # without a package index DAQP's source cannot be fetched
    assert (f"without the static memory of {solver}" in written[1]) == (
        solver != "paper_active_set"
    )
    # An optimiser may remove the access that a sanitizer looks for, and takes three times as long.
    options = "-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
    # Sources of others are compiled as they are.
    warnings = WARNINGS if solver == "paper_active_set" else ()
    replay = compile_c(tmp_path, tmp_path / "replay", *options, warnings=warnings)
    command = [str(replay), str(tmp_path / "trajectory.csv")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len((tmp_path / "trajectory.csv").read_text("utf-8").splitlines())
    assert {line.split(",")[-3] for line in lines[1:]} <= {"0", "1", "2"}


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ControllerData]:
    """The controller of the paper's scenario, written into a folder."""
    folder = tmp_path_factory.mktemp("controller")
    return folder, _generate("paper", folder)


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("name", ["paper", "thrusters"])
def test_the_stated_memory_is_that_of_the_structure(name: str, tmp_path: Path) -> None:
    """`sizeof(controller)` is as in the README."""
    _generate(name, tmp_path)
    main_file = '#include <stdio.h>\n#include "controller.h"\n'
    main_file += 'int main(void) { printf("%zu", sizeof(controller)); return 0; }\n'
    (tmp_path / "main.c").write_text(main_file, encoding="ascii")
    size = subprocess.run([compile_c(tmp_path, tmp_path / "size")], capture_output=True, check=True)
    assert f"| {int(size.stdout)} bytes" in (tmp_path / "README.md").read_text("utf-8")


@needs_gcc
@pytest.mark.slow
def test_cmake_builds_the_example_and_its_test_passes(
    paper: tuple[Path, ControllerData], tmp_path: Path
) -> None:
    """By the generated CMakeLists.txt, as the generated README says."""
    here = Path(sys.executable).parent
    cmake, ctest = (shutil.which(name, path=str(here)) for name in ("cmake", "ctest"))
    if cmake is None or ctest is None or shutil.which("make") is None:
        pytest.skip("there is no cmake here")
    build = str(tmp_path / "build")
    subprocess.run([cmake, "-S", str(paper[0]), "-B", build], check=True, capture_output=True)
    subprocess.run([cmake, "--build", build], check=True, capture_output=True)
    done = subprocess.run([ctest, "--test-dir", build], check=True, capture_output=True, text=True)
    assert "100% tests passed" in done.stdout
    assert "out of 1" in done.stdout


@pytest.mark.slow
@needs_gcc
def test_an_input_that_is_no_number_holds_the_plan(paper: tuple[Path, ControllerData]) -> None:
    """The rest of the last plan is followed, then the command is held; measuring goes on after."""
    folder, data = paper
    controller = CController(folder, data, np.zeros(3))
    limits = np.concatenate([data.low, data.high])
    numbers = np.concatenate([np.zeros(6), [10.0, 10.0, 0.0], limits])
    first, status = controller.step(numbers)
    assert status == 0
    assert np.abs(first).max() > 0.0
    numbers[3] = np.nan
    answers = [controller.step(numbers) for _ in range(8)]
    assert {status for _, status in answers} == {3}
    assert not np.array_equal(answers[0][0], first)
    assert np.array_equal(answers[-1][0], answers[-3][0])
    numbers[3] = 0.0
    assert controller.step(numbers)[1] == 0


@pytest.mark.slow
@needs_gcc
def test_whole_turns_of_the_heading_do_not_matter(paper: tuple[Path, ControllerData]) -> None:
    """A compass that goes from 359 degrees to 1 turns the ship by 2 degrees."""
    folder, data = paper
    rest = np.concatenate([np.zeros(3), data.low, data.high])
    commands = []
    for headings in ((-0.01, 0.01), (2.0 * np.pi - 0.01, 0.01)):
        controller = CController(folder, data, np.zeros(3))
        for heading in headings:
            command, _ = controller.step(np.concatenate([np.zeros(5), [heading], rest]))
        commands.append(command)
    assert np.allclose(commands[0], commands[1], rtol=1e-9, atol=1e-6)
    assert np.abs(commands[0]).max() > 1.0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("turn", "matrices that change at each step"),
        ("thrusters_turning", "matrices that change at each step"),
        ("thrusters_cascade", "without a cascade"),
        ("thruster_loss_soft", "soft limits"),
        ("watch_circle", "output bounds"),
        ("move_filtered", "reference.preview"),
        ("waves", "estimator.kind"),
    ],
)
def test_a_controller_without_c_code_is_refused(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, and nothing is written."""
    assert main(["codegen", name, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_limits_of_what_thrusters_attain_together_are_refused_by_name(tmp_path: Path) -> None:
    scenario = load_scenario("paper@osv").with_keys({"controller.limits": "attainable"})
    with pytest.raises(InputError, match=r'limits = "attainable"; allowed: .* three forces'):
        generate_controller(scenario, out=tmp_path)


def test_an_unknown_solver_is_refused(tmp_path: Path) -> None:
    """The error names those with C sources."""
    with pytest.raises(InputError, match="paper_active_set"):
        generate_controller("paper", "clarabel", out=tmp_path)


def test_an_fmu_of_a_solver_with_one_workspace_is_refused(tmp_path: Path) -> None:
    """A simulator may make several instances."""
    with pytest.raises(InputError, match="paper_active_set"):
        generate_controller("paper", "osqp", out=tmp_path / "c", fmu=tmp_path / "x.fmu")
    assert not (tmp_path / "c").exists()


def test_names_of_thrusters_become_identifiers() -> None:
    """Two that would be the same are numbered."""
    assert make_unique_c_identifiers(["Bow 1", "stern-port", "Bow 1"]) == (
        "bow_1_1",
        "stern_port",
        "bow_1_3",
    )


@needs_gcc
def test_the_c_of_osqp_solves_as_the_wheel_with_given_settings(tmp_path: Path) -> None:
    """The workspace has the given rho and eps; the first command and its iterations are equal."""
    own = "osqp[rho=1.6,eps_abs=1e-5]"
    lines = generate_controller("paper", own, out=tmp_path, steps=20, counts=False)
    judged = "osqp[adaptive_rho=false,eps_abs=1e-5,max_iter=4000,rho=1.6,rho_is_vec=false]"
    assert lines[-1] == f"dpbench run standard --solver '{judged}' --route native --policy warm"
    assert f"--solver '{own}'`" in (tmp_path / "README.md").read_text("utf-8")
    text = (tmp_path / "workspace.c").read_text("ascii").partition("OSQPSettings settings = {")[2]
    values = text.replace("(OSQPFloat)", "").split("}")[0].split(",")
    # In the order of the structure: rho, adaptive_rho, max_iter, eps_abs, eps_rel.
    assert [float(values[i]) for i in (8, 16, 20, 21, 22)] == [1.6, 0.0, 4000.0, 1e-5, 1e-3]

    replay = compile_c(tmp_path, tmp_path / "replay", warnings=())
    done = subprocess.run(
        [replay, tmp_path / "trajectory.csv"], capture_output=True, text=True, check=True
    )
    assert float(done.stderr.split()[6]) < 1e-9
    first = [float(text) for text in done.stdout.splitlines()[1].split(",")]
    data = read_controller_data_of_scenario(load_scenario("paper"))
    qp = record_sequence("paper").problem(0)
    rows = scipy.sparse.csc_matrix(np.vstack([qp.A, np.eye(qp.n)]))
    limits = np.concatenate([qp.l, qp.lb]), np.concatenate([qp.u, qp.ub])
    solver = osqp.OSQP()
    settings = {"rho": 1.6, "eps_abs": 1e-5, "adaptive_rho": False, "verbose": False}
    solver.setup(scipy.sparse.csc_matrix(qp.P), 0 * qp.q, rows, *limits, **settings)
    solver.update(q=qp.q)
    answer = solver.solve(raise_error=False)
    move = np.clip(answer.x[:3], -1.0, 1.0) * data.du_max
    assert np.allclose(first[1:4], move, rtol=1e-9)
    assert first[5] == answer.info.iter


@pytest.mark.parametrize(("limit", "unsolved"), [(1, "3 of 3 steps"), (10_000, "")])
def test_steps_that_stop_at_the_iteration_limit_are_counted(
    limit: int, unsolved: str, tmp_path: Path
) -> None:
    """With one iteration no step is solved; with many, all are."""
    own = f"osqp[eps_abs=1e-3,max_iter={limit}]"
    lines = generate_controller("paper", own, out=tmp_path, steps=3, counts=False)
    found = [line for line in lines if "without the status solved" in line]
    words = (
        f"{unsolved} of the recorded loop ended without the status solved (max_iter = {limit}): "
    )
    assert found == [f"{words}judge the settings with dpbench run."] * bool(unsolved)
    text = (tmp_path / "README.md").read_text("utf-8")
    assert f"max_iter={limit}" in text
    assert [line for line in text.splitlines() if "without the status solved" in line] == found


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"adaptive_rho": True}, "adaptive_rho: found true"),
        ({"polishing": True}, "cannot change rho, polish"),
        ("high_polished", "cannot change rho, polish"),
        ({"rhoo": 1.0}, "rhoo: found an unknown option; allowed: rho"),
    ],
)
def test_settings_that_the_c_of_osqp_cannot_have_are_refused(
    settings: Settings, words: str
) -> None:
    """With the option; an option of the library that is misspelt, too."""
    qp = read_controller_data_of_scenario(load_scenario("paper")).qp
    with pytest.raises(InputError, match=words):
        generate_c_sources_of_osqp(qp, settings)


def test_presets_of_osqp_have_a_constant_rho() -> None:
    """Only the adaptation of rho differs from the preset."""
    qp = read_controller_data_of_scenario(load_scenario("paper")).qp
    options = generate_c_sources_of_osqp(qp, "1e-4").options
    constant = {"adaptive_rho": False, "rho_is_vec": False}
    assert options == {**constant, "eps_abs": 1e-4, "eps_rel": 0.0, "max_iter": 200_000}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--solver", "osqp[rho=[1,2]]"], "one value per option"),
        (
            ["--solver", "osqp[rho=1]", "--settings", "high"],
            "found 'high' with the options in osqp[rho=1]; allowed: a preset or options, not both",
        ),
        (["--solver", "paper_active_set[rho=1]"], "allowed: no settings"),
        (["--solver", "daqp[primal=1]"], "primal: found an unknown option"),
    ],
)
def test_other_settings_are_refused(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, and nothing is written."""
    assert main(["codegen", "paper", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()

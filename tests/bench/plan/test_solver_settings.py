"""Custom settings in a suite and on the command line, from the text to the cells."""

from pathlib import Path
from traceback import format_exception

import pytest

from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.record.cell import Cell
from dpbench.errors import DpbenchError, InputError, PolicyError, SettingsError, UnknownNameError
from dpbench.solvers.settings import find_options_of_preset

OSQP = "osqp = { rho = 1.6, eps_abs = 1e-5 }"
SUITE = """
title = "Custom settings"
solvers = ["osqp", "daqp"]
baseline_law = false

[settings.mine]
osqp = { rho = 1.6, eps_abs = 1e-5 }

[settings.grid]
osqp = { rho = [0.1, 1.0], max_iter = 900 }
daqp = { primal_tol = 1e-7 }

[[replay]]
scenario = "paper"
steps = 5
settings = ["default", "mine"]
"""


@pytest.fixture
def suite(tmp_path: Path) -> str:
    path = tmp_path / "own.toml"
    path.write_text(SUITE)
    return str(path)


def describe(cells: list[PlannedCell]) -> list[tuple[str, str, object]]:
    return [(p.cell.solver, p.cell.settings, p.cell.solver_settings) for p in cells]


def test_a_suite_names_settings_of_its_own(suite: str) -> None:
    """A solver without options in `[settings.NAME]` does not run at that name."""
    assert describe(RunRequest(suite).make_plan().cells) == [
        ("osqp", "default", "default"),
        ("osqp", "mine", {"rho": 1.6, "eps_abs": 1e-5}),
        ("daqp", "default", "default"),
    ]


def test_only_settings_of_ones_own_can_be_chosen(suite: str) -> None:
    plan = RunRequest(suite, settings=["grid"]).make_plan()
    assert describe(plan.cells) == [
        ("osqp", "grid[rho=0.1]", {"rho": 0.1, "max_iter": 900}),
        ("osqp", "grid[rho=1.0]", {"rho": 1.0, "max_iter": 900}),
        ("daqp", "grid", {"primal_tol": 1e-7}),
    ]
    assert plan.part


def test_a_solver_is_chosen_with_settings_on_the_command_line(suite: str) -> None:
    """Beside the solver alone it runs as well; in place of the table's settings."""
    solvers = ["osqp[rho=[0.5,2],eps_abs=1e-5]", "daqp"]
    assert describe(RunRequest(suite, solvers=solvers).make_plan().cells) == [
        ("osqp", "eps_abs=1e-5,rho=0.5", {"rho": 0.5, "eps_abs": 1e-5}),
        ("osqp", "eps_abs=1e-5,rho=2", {"rho": 2, "eps_abs": 1e-5}),
        ("daqp", "default", "default"),
    ]


def test_chosen_settings_also_run_for_a_solver_named_with_options(suite: str) -> None:
    """On the command line and in a suite, whose plan is the same when it is run again."""
    ran = [("osqp", "rho=2", {"rho": 2}), ("osqp", "mid", "mid")]
    plan = RunRequest(suite, solvers=["osqp[rho=2]"], settings=["mid"]).make_plan()
    assert describe(plan.cells) == ran
    with pytest.raises(SettingsError, match="found 'middle'"):
        RunRequest(suite, solvers=["osqp[rho=2]"], settings=["middle"]).make_plan()
    text = Path(suite).read_text()
    Path(suite).write_text(text.replace('["osqp", "daqp"]', '["osqp[rho=2]"]'))
    plan = RunRequest(suite, settings=["mid"]).make_plan()
    assert describe(plan.cells) == ran
    Path(suite).write_text(plan.format_suite(Path(suite).parent))
    assert RunRequest(suite).make_plan().digest == plan.digest


def test_each_settings_run_at_each_limit_of_iterations(suite: str) -> None:
    """By the option of each solver; one without such an option takes no part."""
    text = Path(suite).read_text().replace('"daqp"]', '"daqp", "osqp[rho=2]", "paper_active_set"]')
    Path(suite).write_text(f"{text}iteration_limits = [1, 50]\n")
    cells = describe(RunRequest(suite).make_plan().cells)
    default, mine = find_options_of_preset("default", "osqp"), {"rho": 1.6, "eps_abs": 1e-5}
    assert [cell for cell in cells if cell[1].endswith("[max_iter=50]")] == [
        ("osqp", "default[max_iter=50]", {**default, "max_iter": 50}),
        ("osqp", "mine[max_iter=50]", {**mine, "max_iter": 50}),
        ("osqp", "rho=2[max_iter=50]", {"rho": 2, "max_iter": 50}),
    ]
    assert [cell for cell in cells if cell[0] != "osqp"] == [
        ("daqp", "default[iter_limit=1]", {"iter_limit": 1}),
        ("daqp", "default[iter_limit=50]", {"iter_limit": 50}),
    ]
    assert len(cells) == 8


def test_limits_of_time_are_added_to_those_of_iterations(suite: str) -> None:
    """The paper's method has no option for time."""
    text = Path(suite).read_text().replace('"daqp"]', '"daqp", "paper_active_set"]')
    Path(suite).write_text(f"{text}iteration_limits = [1]\ntime_limits = [1e-4]\n")
    cells = describe(RunRequest(suite, settings=["default"]).make_plan().cells)
    assert [cell for cell in cells if cell[0] != "osqp"] == [
        ("daqp", "default[iter_limit=1]", {"iter_limit": 1}),
        ("daqp", "default[time_limit=0.0001]", {"time_limit": 1e-4}),
    ]


def test_a_limit_of_iterations_replaces_that_of_a_preset(suite: str) -> None:
    Path(suite).write_text(f"{Path(suite).read_text()}iteration_limits = [3]\n")
    plan = RunRequest(suite, solvers=["osqp"], settings=["high"]).make_plan()
    ((_, name, options),) = describe(plan.cells)
    assert name == "high[max_iter=3]"
    assert options == {**find_options_of_preset("high", "osqp"), "max_iter": 3}


def test_settings_with_the_same_options_are_one_cell(suite: str) -> None:
    """Also of other notation or another table; a line names the others."""
    text = Path(suite).read_text().replace('"osqp",', '"osqp", "osqp[eps_abs=1e-5,rho=1.60]",')
    again = '[[replay]]\nscenario = "calm"\nsteps = 5\nsettings = ["twin"]\n'
    twin = "[settings.twin]\nosqp = { rho = 1.6, eps_abs = 0.00001 }\n"
    Path(suite).write_text(f"{text}\n{again}\n{twin}")
    plan = RunRequest(suite).make_plan()
    own = [(p.cell.scenario_name, p.cell.settings) for p in plan.cells if p.cell.options]
    assert own == [("paper", "mine"), ("calm", "mine")]
    assert plan.remarks[0] == (
        "osqp: settings eps_abs=1e-5,rho=1.6, twin have the same options as mine and share its row"
    )


@pytest.mark.parametrize(
    ("modes", "ran", "remark"),
    [
        ("", [("qpsolvers", "fresh", "mine"), ("native", "warm", "twin")], ""),
        (
            'routes = ["native"]\npolicies = ["warm"]\n',
            [("native", "warm", "mine")],
            "osqp: settings twin have the same options as mine and share its row",
        ),
    ],
)
def test_equal_options_in_another_call_mode_are_settings_of_their_own(
    suite: str, modes: str, ran: list[tuple[str, str, str]], remark: str
) -> None:
    """A mode that the settings fix parts them, unless the others have it too."""
    text = Path(suite).read_text().replace('["default", "mine"]', '["mine", "twin"]')
    twin = f'[settings.twin]\nroute = "native"\npolicy = "warm"\n{OSQP}\n'
    Path(suite).write_text(f"{text}{modes}\n{twin}")
    plan = RunRequest(suite, solvers=["osqp"]).make_plan()
    assert [(p.cell.route, p.cell.policy, p.cell.settings) for p in plan.cells] == ran
    assert [text for text in plan.remarks if "same options" in text] == [remark] * bool(remark)


def test_a_line_names_the_call_modes_in_which_settings_share_a_row(suite: str) -> None:
    """`twin` has a row of its own in the mode that `mine` has not."""
    text = Path(suite).read_text().replace('["default", "mine"]', '["mine"]')
    again = '[[replay]]\nscenario = "paper"\nsteps = 5\nsettings = ["twin"]\n'
    again += 'policies = ["fresh", "warm"]\n'
    Path(suite).write_text(f"{text}\n{again}\n[settings.twin]\n{OSQP}\n")
    plan = RunRequest(suite, solvers=["osqp"]).make_plan()
    assert [(p.cell.policy, p.cell.settings) for p in plan.cells] == [
        ("fresh", "mine"),
        ("warm", "twin"),
    ]
    assert plan.remarks[0] == (
        "osqp: settings twin have the same options as mine and share its row in the call mode "
        "qpsolvers fresh"
    )


def test_a_whole_number_equals_a_decimal_one(suite: str) -> None:
    solvers = ["osqp[rho=1]", "osqp[rho=1.0]", "osqp[rho=2]", "osqp[rho=2]"]
    plan = RunRequest(suite, solvers=solvers).make_plan()
    assert [p.cell.settings for p in plan.cells] == ["rho=1", "rho=2"]
    assert list(plan.remarks[:2]) == [
        "osqp[rho=2] is given 2 times and is run once",
        "osqp: settings rho=1.0 have the same options as rho=1 and share its row",
    ]


def test_options_are_part_of_what_a_cell_is(suite: str) -> None:
    """Cells of presets keep their identity; other options under one name are another cell."""
    cells = [p.cell for p in RunRequest(suite, settings=["default", "mine"]).make_plan().cells]
    assert "options" not in cells[0].to_json()
    assert Cell.from_json(cells[1].to_json()) == cells[1]
    text = Path(suite).read_text().replace("rho = 1.6", "rho = 1.7")
    Path(suite).write_text(text)
    again = [p.cell for p in RunRequest(suite, settings=["default", "mine"]).make_plan().cells]
    assert [a.key == b.key for a, b in zip(cells, again, strict=True)] == [True, False, True]


def test_the_tables_of_a_suite_may_name_a_choice_or_its_solver(suite: str) -> None:
    text = Path(suite).read_text().replace('"osqp",', '"osqp[rho=1]", "osqp[rho=2]",')
    for table, expected in (
        ('solvers = ["osqp"]', ["rho=1", "rho=2"]),
        ('solvers = ["osqp[rho=2]"]', ["rho=2"]),
        ('without = ["daqp", "osqp[rho=1]"]', ["rho=2"]),
    ):
        Path(suite).write_text(f"{text}{table}\n".replace('"default", "mine"', '"default"'))
        assert [p.cell.settings for p in RunRequest(suite).make_plan().cells] == expected


@pytest.mark.parametrize(
    ("old", "new", "kind", "message"),
    [
        ("rho = 1.6", "rhoo = 1.6", SettingsError, r"settings\.mine\.osqp: rhoo: .*: rho, "),
        ("rho = 1.6", 'rho = "x"', SettingsError, r"settings\.mine\.osqp: rho: found 'x'"),
        ("rho = 1.6", "rho = []", InputError, r"settings\.mine\.osqp: rho: found \[\]"),
        ("rho = 1.6", "rho = 1979-05-27", InputError, r"settings\.mine\.osqp\.rho"),
        ("settings.mine", "settings.high", InputError, r"settings\.high: found the name of a p"),
        ("settings.mine", 'settings."1e-4"', InputError, r"settings\.1e-4: found a tolerance as"),
        ("osqp = { rho = 1.6", "osqq = { rho = 1.6", UnknownNameError, r"mine\.osqq: .*osqp"),
        (OSQP, "osqp = {}", InputError, r"mine\.osqp"),
        (OSQP, "rho = 1.6", InputError, r"mine\.rho: found 1\.6; allowed: route, policy, or the t"),
        (OSQP, f'policy = "hot"\n{OSQP}', InputError, r"settings\.mine\.policy: found 'hot'"),
        (OSQP, 'policy = "warm"\nclarabel = { tol_feas = 1 }', PolicyError, r"mine\.clarabel: pol"),
        (OSQP, 'route = "qpsolvers"\nhpipm_ocp = { mu0 = 1.0 }', PolicyError, r"hpipm_ocp: rou"),
        ('"osqp",', '"osqp[rhoo=1]",', SettingsError, r"solvers: osqp\[rhoo\]: .*: rho, "),
        ('"osqp",', '"osqp[rho=[]]",', InputError, r"solvers: rho: found \[\]"),
        ('"mine"', '"mien"', SettingsError, r"settings: found 'mien'; allowed: .*mine"),
    ],
)
def test_a_mistake_in_a_suite_is_named(
    suite: str, old: str, new: str, kind: type[DpbenchError], message: str
) -> None:
    Path(suite).write_text(Path(suite).read_text().replace(old, new))
    with pytest.raises(kind, match=rf"own\.toml: .*{message}") as raised:
        RunRequest(suite).make_plan()
    assert "".join(format_exception(raised.value)).count("Traceback") == 1


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("osqp[rhoo=1.6]", r"`solvers`: osqp\[rhoo\]: found an unknown option; allowed: rho, "),
        ("quadprog[tol=1e-6]", r"`solvers`: quadprog\[tol\]: .*: no settings"),
        ("all[rho=1]", "found 'all'"),
    ],
)
def test_a_mistake_in_a_choice_is_named(suite: str, choice: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        RunRequest(suite, solvers=[choice]).make_plan()


def test_a_backup_has_no_settings_of_its_own(suite: str) -> None:
    loop = '[[closed_loop]]\nscenarios = ["calm"]\nbackup = "daqp[primal_tol=[1e-7,1e-8]]"\n'
    Path(suite).write_text(f"{Path(suite).read_text()}{loop}")
    with pytest.raises(InputError, match=r"closed_loop\.backup: found 'daqp\["):
        RunRequest(suite).make_plan()

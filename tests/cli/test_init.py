"""`dpbench init`: three files of one's own ship; what cannot be is refused."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.cli.main import main
from dpbench.cli.ship.own_ship import (
    OwnShip,
    render_scenario_file,
    render_suite_file,
    render_vessel_file,
)
from dpbench.scenario.hull_files import read_hull_from_mss_file
from dpbench.scenario.own_ship import (
    DP_NUMBERS,
    LIBRARY,
    Particulars,
    ThrustLimits,
    scale_library_vessel_to_own_ship,
)
from dpbench.scenario.scenario import load_scenario, load_vessel

CUT = Path(__file__).parents[1] / "scenario" / "mss" / "supply_cut.mat"
PARTICULARS = {"length": 80, "breadth": 18, "draught": 6, "displacement": 6000, "thrust": 300}
PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "own-ship.md").read_text(encoding="utf-8")
SHIP = ["init", "my_ship", *(word for k, v in PARTICULARS.items() for word in (f"--{k}", str(v)))]
FILES = ("my_ship.toml", "my_ship_weather.toml", "my_ship_suite.toml")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that exits with 2."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert not captured.out
    return line


def without(option: str) -> list[str]:
    """The ship's command line without an option."""
    at = SHIP.index(option)
    return SHIP[:at] + SHIP[at + 2 :]


def test_the_three_files_are_of_one_ship(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SHIP) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in FILES)
    assert max(map(len, said.splitlines())) <= 80
    vessel, scenario = load_vessel(FILES[0]), load_scenario(FILES[1])
    assert vessel.length_m == 80.0 and vessel.tau_max[0] == 3e5
    np.testing.assert_array_equal(scenario.vessel.M, vessel.M)
    path, suite = load_path_and_suite(FILES[2])
    cells = plan_suite(suite, beside=path.parent)
    assert {cell.cell.solver for cell in cells} >= {"daqp", "quadprog", "osqp"}
    assert suite.requirements.deadline_ms == pytest.approx(1000 * scenario.sample_s)


def test_the_vessel_file_says_how_it_was_made() -> None:
    main(SHIP)
    text = Path(FILES[0]).read_text(encoding="utf-8").replace("\n# ", " ")
    for said in ("Bis system", "supply_mss", "Valid for", "Clarke", "--displacement 6000"):
        assert said in text
    assert "CAUTION" not in text
    main([*SHIP[:2], "--length", "120", *SHIP[4:], "--force"])
    text = Path(FILES[0]).read_text(encoding="utf-8").replace("\n# ", " ")
    assert "supply_mss: L/B and L/volume^(1/3) differ by more than 20 %" in text


def test_the_files_state_the_scaled_sample_time_and_the_runs_of_the_baseline_law() -> None:
    """0.3 s of a ship of 76.2 m: 0.307 s at 80 m and 0.37 s at 116 m, in steps of 0.05 s."""
    main(SHIP)
    assert "with the square root of the length this is 0.307 s" in " ".join(
        Path(FILES[1]).read_text(encoding="utf-8").replace("\n# ", " ").split()
    )
    main([*SHIP[:2], "--length", "116", *SHIP[4:], "--force"])
    text = " ".join(Path(FILES[1]).read_text(encoding="utf-8").replace("\n# ", " ").split())
    assert (
        "with the square root of the length this is 0.37 s, rounded to a multiple of 0.05 s."
        in text
    )
    assert "sample_s = 0.35" in text
    suite = Path(FILES[2]).read_text(encoding="utf-8")
    assert "unconstrained_clipped" in suite
    assert "\nbaseline_law = true\n" in suite


@pytest.mark.slow
@given(
    length_m=st.floats(10.0, 500.0),
    slender=st.floats(2.5, 9.0),
    shallow=st.floats(2.0, 5.0),
    block=st.floats(0.31, 0.99),
    weight_share=st.floats(6e-4, 0.19),
    like=st.sampled_from(sorted(LIBRARY)),
    number=st.sampled_from(sorted(DP_NUMBERS)),
)
def test_any_ship_that_is_allowed_becomes_files_that_are(
    length_m: float,
    slender: float,
    shallow: float,
    block: float,
    weight_share: float,
    like: str,
    number: int,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    breadth_m = length_m / slender
    draught_m = breadth_m / shallow
    mass_kg = block * 1026.0 * length_m * breadth_m * draught_m
    own = Particulars(length_m, breadth_m, draught_m, mass_kg)
    vessel = scale_library_vessel_to_own_ship(
        like, own, ThrustLimits(weight_share * mass_kg * 9.81), "own"
    )
    folder = tmp_path_factory.mktemp("own")
    texts = {
        "own.toml": render_vessel_file(OwnShip("own", own, vessel, like, None), "a command"),
        "sea.toml": render_scenario_file("own", vessel, number, chosen=False),
        "suite.toml": render_suite_file("own", "sea.toml", vessel, number),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    read = load_scenario(folder / "sea.toml").vessel
    for key in ("M", "D", "tau_min", "tau_max", "rate_max"):
        np.testing.assert_allclose(getattr(read, key), getattr(vessel, key), rtol=1e-5)
    assert read.windage is not None and vessel.windage is not None
    assert read.windage.lateral_m2 == pytest.approx(vessel.windage.lateral_m2, rel=1e-5)
    path, suite = load_path_and_suite(folder / "suite.toml")
    assert plan_suite(suite, beside=path.parent)
    assert load_scenario(folder / "sea.toml").steps == 1000


@pytest.mark.slow
def test_a_hull_of_the_mss_toolbox(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--thrust" in refused(["init", "supply", "--from-mss", str(CUT)], capsys)
    assert main(["init", "supply", "--from-mss", str(CUT), "--thrust", "500"]) == 0
    vessel, hull = load_vessel("supply.toml"), read_hull_from_mss_file(CUT)
    np.testing.assert_allclose(vessel.M, hull.M, rtol=1e-5)
    np.testing.assert_allclose(vessel.D, hull.D, rtol=1e-5)
    assert vessel.length_m == pytest.approx(82.8)
    text = Path("supply.toml").read_text(encoding="utf-8").replace("\n# ", " ")
    assert "strip theory may be weak" in text


def test_a_hull_of_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    rows = "coefficient,value\nM11,7e6\nM22,8e6\nM66,4e9\nD11,2e5\nD22,8e5\nD66,3e8\nlength_m,80\n"
    Path("ship.csv").write_text(rows, encoding="utf-8")
    command = ["init", "mine", "--from-csv", "ship.csv", "--thrust", "300"]
    assert "--breadth" in refused(command, capsys)
    more = ["--breadth", "18", "--draught", "6", "--displacement", "5900", "--length", "82"]
    assert main([*command, *more]) == 0
    vessel = load_vessel("mine.toml")
    np.testing.assert_array_equal(vessel.M, np.diag([7e6, 8e6, 4e9]))
    assert vessel.length_m == 82.0


def test_the_same_ship_in_another_sea(capsys: pytest.CaptureFixture[str]) -> None:
    main(SHIP)
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    capsys.readouterr()
    assert "--sea" in refused(["init", "my_ship"], capsys)
    assert main(["init", "my_ship", "--sea", "6"]) == 0
    for name, content in before.items():
        assert Path(name).read_bytes() == content
    scenario = load_scenario("my_ship_sea6.toml")
    assert scenario.environment.wind is not None
    assert scenario.environment.wind.speed_mps == 13.8
    assert (
        load_path_and_suite("my_ship_sea6_suite.toml")[1].replay[0].scenario == "my_ship_sea6.toml"
    )
    assert "cannot hold" in capsys.readouterr().out


def test_the_hardest_sea_that_the_ship_holds_is_suggested(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """97 % of the limits at DP capability number 4; number 5 is beyond them."""
    main([*SHIP, "--out", "ships"])
    printed = capsys.readouterr().out
    (command,) = re.findall(r"harder: dpbench (init my_ship --sea \d .*)", printed)
    more = (
        "(more wind from the same direction: 7.9 m/s from 30°; mean force of level 1: 97 % of the"
    )
    assert more in " ".join(printed.split())
    assert main(shlex.split(command)) == 0
    harder = capsys.readouterr().out
    assert "harder" not in harder
    assert "cannot hold" not in harder
    larger = int(command.split()[3]) + 1
    assert main(["init", "my_ship", "--sea", str(larger), "--out", "ships"]) == 0
    assert "cannot hold" in capsys.readouterr().out


def test_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path(FILES[2]).write_text("mine", encoding="utf-8")
    line = refused(SHIP, capsys)
    assert FILES[2] in line and "--force" in line
    assert [path.name for path in tmp_path.iterdir()] == [FILES[2]]
    assert main([*SHIP, "--out", "fleet/new"]) == 0
    assert {path.name for path in (tmp_path / "fleet" / "new").iterdir()} == set(FILES)
    assert Path(FILES[2]).read_text(encoding="utf-8") == "mine"
    assert main([*SHIP, "--force"]) == 0
    assert Path(FILES[2]).read_text(encoding="utf-8") != "mine"


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (without("--draught"), ["--draught", "missing", "0.5 to 40 m"]),
        (without("--thrust"), ["--thrust", "missing", "kN"]),
        ([*SHIP, "--length", "eighty"], ["--length", "'eighty'", "10 to 500 m"]),
        ([*SHIP, "--length", "nan"], ["--length", "'nan'", "10 to 500 m"]),
        ([*SHIP, "--breadth", "-18"], ["--breadth", "'-18'", "2 to 100 m"]),
        ([*SHIP, "--displacement", "60000"], ["--displacement", "60000 t", "6.8", "0.3 to 1"]),
        ([*SHIP, "--thrust", "90000"], ["--thrust", "90000", "29.4 to 11800 kN"]),
        ([*SHIP, "--sway-thrust", "0"], ["--sway-thrust", "'0'", "kN"]),
        ([*SHIP, "--yaw-moment", "9e6"], ["--yaw-moment", "9e+06", "kN·m"]),
        ([*SHIP, "--like", "ferry"], ["--like", "'ferry'", "supply_fs99"]),
        ([*SHIP, "--sea", "12"], ["--sea", "'12'", "1 to 9"]),
        ([*SHIP, "--from-mss", "a.mat", "--from-csv", "b.csv"], ["--from-csv", "give one of them"]),
        ([*SHIP, "--from-mss", "no.mat"], ["no.mat", "no such file"]),
        (["init", "../my_ship", *SHIP[2:]], ["NAME", "'../my_ship'", "letters"]),
        (["init", "my_ship"], ["--length", "missing"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    arguments: list[str], parts: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(arguments, capsys)
    assert all(part in line for part in parts), line
    assert not list(tmp_path.iterdir())


def commands() -> list[list[str]]:
    """The commands of the page in the order a reader gives them; no browser is opened."""
    shown = [block.split("```")[0] for block in PAGE.split("```sh\n")[1:]]
    lines = [line for block in shown for line in block.splitlines()]
    return [line.removesuffix(" --open").split()[1:] for line in lines]


def test_the_page_shows_what_is_written_and_read(tmp_path: Path) -> None:
    assert commands()[0] == SHIP
    table = PAGE.split("```csv\n")[1].split("```")[0]
    (tmp_path / "ship.csv").write_text(table, encoding="utf-8")
    assert main(["init", "ship", "--from-csv", "ship.csv", "--thrust", "300"]) == 0
    shipped = load_vessel("supply_tmr")
    np.testing.assert_allclose(load_vessel("ship.toml").M, shipped.M, rtol=1e-5)


@pytest.mark.slow
def test_own_ship_from_init_to_its_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--solver", "quadprog", "--solver", "daqp", "--steps", "60"]
    for words in commands():
        assert main(words + short * (words[0] == "run")) == 0
        said = capsys.readouterr().out
        if words[0] == "check":
            assert said in PAGE
    assert "results/my_ship_suite/report.html" in PAGE
    for suite in ("my_ship_suite", "my_ship_sea1_suite"):
        assert (tmp_path / "results" / f"{suite}-part" / "report.html").stat().st_size > 1e5

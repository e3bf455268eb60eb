"""The FMU of a scenario is checked as it is read: one line with file, key and what is allowed."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from dpbench import InputError, load_scenario
from dpbench.cli.main import main
from dpbench.scenario.plants.fmu_interface import read_fmu_interface
from dpbench.scenario.scenario import build_scenario_from_documents
from tests.scenario.plants.fmus import describe, describe_otherwise, needs_fmi, write_scenario

pytestmark = needs_fmi


def read_changed(fmu: Path, folder: Path, old: str, new: str) -> None:
    """Read a scenario with an FMU after a change of its text."""
    path = write_scenario(folder, str(fmu), weather=False)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    load_scenario(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('surge = "Fx"', 'surge = "FX"', "inputs.surge: found 'FX', which ship2.fmu does not have"),
        ('surge = "Fx"', 'surge = "FX"', "allowed: a real-valued input: one of Fx, Fy, Mz"),
        (
            'surge = "Fx"',
            'surge = "u"',
            "'u', which has causality output and type Real in ",
        ),
        ('heading = "psi"', 'heading = "r"', "outputs.heading: found 'r' in 'rad/s'; allowed: rad"),
        ('yaw = "Mz"', 'yaw = "Fx"', r"inputs.yaw: found 'Fx' in 'N'; allowed: N\.m"),
        ('north = "n0"', 'north = "n"', "start.north: found 'n', which has causality output"),
        ("[plant.fmu.parameters]", "[plant.fmu.parameters]\nmass = 1.0", "parameters.mass: found"),
        ("[plant.fmu]", "[plant.fmu]\nstep_s = 0.2", "step_s: found 0.2; allowed: the sample t"),
        ("[plant.fmu]", '[plant.fmu]\nsha256 = "00"', "sha256: found '00'; allowed: [0-9a-f]{64}"),
        ("[plant.fmu]", "[plant]\nmass_percent = 5.0\n[plant.fmu]", "either fmu, which repl"),
        ("[environment]", "[environment]\nmean_kN = [1.0, 0.0, 0.0]", "environment.mean_kN: found"),
        ("ship2.fmu", "none.fmu", "plant.fmu.file: no such file '.*none.fmu'"),
    ],
)
def test_what_does_not_fit_is_said_with_its_key(
    fmu2: Path, tmp_path: Path, old: str, new: str, words: str
) -> None:
    with pytest.raises(InputError, match=words) as said:
        read_changed(fmu2, tmp_path, old, new)
    assert str(said.value).startswith(str(tmp_path / "case.toml"))


def test_no_fmu_at_all_is_one_line_of_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fmu = tmp_path / "text.fmu"
    fmu.write_text("no zip file")
    assert main(["check", str(write_scenario(tmp_path, "text.fmu"))]) == 2
    error = capsys.readouterr().err
    assert "plant.fmu.file: found text.fmu, an invalid FMU" in error.replace("\n", " ")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="1.0"', "invalid FMU|FMI 1.0"),
        ("CoSimulation modelIdentifier", "ModelExchange modelIdentifier", "no co-simulation"),
        ('unit="N"', 'unit="lbf"', r"found 'Fx' in 'lbf', a unit that ship2\.fmu does not define"),
    ],
)
def test_a_model_description_that_does_not_fit(
    fmu2: Path, tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = describe(2).replace('<Unit name="kg">', '<Unit name="lbf"/><Unit name="kg">')
    text = text.replace(old, new)
    if "ModelExchange" in new:
        text = text.replace(' canHandleVariableCommunicationStepSize="true"', "")
    fmu = describe_otherwise(fmu2, tmp_path, text)
    with pytest.raises(InputError, match=words):
        load_scenario(write_scenario(tmp_path, fmu.name))


def test_an_fmu_of_another_system_is_refused(fmu2: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(fmu2) as own, zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", own.read("modelDescription.xml"))
        archive.writestr("binaries/win64/ship.dll", b"")
    with pytest.raises(
        InputError, match=r"found other\.fmu for win64; allowed: an FMU for linux64"
    ):
        load_scenario(write_scenario(tmp_path, "other.fmu"))


def test_units_are_converted_by_their_definition(fmu3: Path, tmp_path: Path) -> None:
    load = load_scenario(write_scenario(tmp_path, str(fmu3)))
    assert load.fmu is not None
    interface = read_fmu_interface(Path(load.fmu.table.file), load.fmu.table, "test")
    assert interface.inputs.si_per_unit.tolist() == [1e3, 1e3, 1e3]
    degree = np.pi / 180
    assert interface.outputs.si_per_unit.tolist() == [1.0, 1.0, degree, 1.0, 1.0, degree]
    assert len(load.fmu.table.sha256) == 64


def test_documents_are_read_without_the_file(fmu2: Path, tmp_path: Path) -> None:
    """A report reads a scenario from its results, where no FMU is opened or needed."""
    copy = tmp_path / "ship.fmu"
    copy.write_bytes(fmu2.read_bytes())
    files = load_scenario(write_scenario(tmp_path, "ship.fmu")).files
    copy.unlink()
    again = build_scenario_from_documents(files)
    assert again.fmu is not None
    assert again.fmu.table.sha256 == files["scenario"]["plant"]["fmu"]["sha256"]

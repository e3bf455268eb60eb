"""The project's own ship as FMUs, built here: FMI 2.0 in SI units, FMI 3.0 in kN and degrees."""

import importlib.util
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from dpbench.scenario.scenario import load_scenario

COMPILER = shutil.which("cc") or ""
_missing = [name for name in ("fmpy",) if importlib.util.find_spec(name) is None]
needs_fmi = pytest.mark.skipif(
    bool(_missing) or not COMPILER, reason="FMPy (extra fmi) or a C compiler is missing"
)
SOURCE = Path(__file__).with_name("ship_fmu.c")
FORCES, STATES = ("Fx", "Fy", "Mz"), ("u", "v", "r", "n", "e", "psi")
FAULTS = {"error": 1, "hang": 2, "crash": 3, "at start": 4, "nan": 5}
_UNITS = {
    "N": 'kg="1" m="1" s="-2"',
    "N.m": 'kg="1" m="2" s="-2"',
    "kN": 'kg="1" m="1" s="-2" factor="1000"',
    "kN.m": 'kg="1" m="2" s="-2" factor="1000"',
    "m": 'm="1"',
    "m/s": 'm="1" s="-1"',
    "rad": 'rad="1"',
    "rad/s": 'rad="1" s="-1"',
    "deg": f'rad="1" factor="{np.pi / 180!r}"',
    "deg/s": f'rad="1" s="-1" factor="{np.pi / 180!r}"',
    "kg": 'kg="1"',
}


def list_variables(version: int) -> list[tuple[str, str, str]]:
    """Return name, causality and unit of the variables, in the order of their references."""
    k, angle = ("", "rad") if version == 2 else ("k", "deg")
    units = ("m/s", "m/s", f"{angle}/s", "m", "m", angle)
    variables = [(name, "input", f"{k}N") for name in FORCES[:2]] + [("Mz", "input", f"{k}N.m")]
    variables += [(name, "output", unit) for name, unit in zip(STATES, units, strict=True)]
    variables += [(f"{name}0", "parameter", unit) for name, unit in zip(STATES, units, strict=True)]
    for name in ("amplitude", "period", "phase"):
        variables += [(f"{name}{i}", "parameter", "") for i in range(3)]
    return [*variables, ("fault", "parameter", ""), ("fault_s", "parameter", "")]


def describe(version: int, identifier: str = "ship") -> str:
    """Return the model description of the ship."""
    units = "".join(f'<Unit name="{n}"><BaseUnit {base}/></Unit>' for n, base in _UNITS.items())
    rows, outputs = [], []
    for i, (name, causality, unit) in enumerate(list_variables(version)):
        start = "" if causality == "output" else 'start="0"'
        in_unit = f'unit="{unit}"' if unit else ""
        kind = 'variability="fixed"' if causality == "parameter" else 'variability="continuous"'
        about = f'name="{name}" valueReference="{i}" causality="{causality}" {kind}'
        if version == 2:
            rows.append(f"<ScalarVariable {about}><Real {start} {in_unit}/></ScalarVariable>")
        else:
            rows.append(f"<Float64 {about} {start} {in_unit}/>")
        if causality == "output":
            outputs.append(
                f'<Unknown index="{i + 1}"/>' if version == 2 else f'<Output valueReference="{i}"/>'
            )
    variables, ends = "".join(rows), "".join(outputs)
    if version == 2:
        ends = f"<Outputs>{ends}</Outputs><InitialUnknowns>{ends}</InitialUnknowns>"
        token = 'guid="{1}"'
    else:
        time = 'name="time" valueReference="99" causality="independent" variability="continuous"'
        variables += f"<Float64 {time}/>"
        token = 'instantiationToken="{1}"'
    return (
        f'<fmiModelDescription fmiVersion="{version}.0" modelName="ship" {token}>'
        f'<CoSimulation modelIdentifier="{identifier}" '
        f'canHandleVariableCommunicationStepSize="true"/>'
        f"<UnitDefinitions>{units}</UnitDefinitions><ModelVariables>{variables}</ModelVariables>"
        f"<ModelStructure>{ends}</ModelStructure></fmiModelDescription>"
    )


def list_stubs(version: int) -> list[str]:
    """Return the functions of FMI that the ship does not need and every FMU exports."""
    from fmpy import fmi2, fmi3

    slave = fmi2.FMU2Slave if version == 2 else fmi3.FMU3Slave
    text = SOURCE.read_text()
    own = set(re.findall(r"(?:fmi[23]|NAME\()(\w+)", text))
    names = [name for name in dir(slave) if name.startswith(f"fmi{version}")]
    return [name for name in names if name.removeprefix(f"fmi{version}") not in own]


def build_ship_fmu(folder: Path, version: int, counter: str = "") -> Path:
    """Return the path of an FMU of `supply_fs99`, made in a folder.

    counter : file by which all instances but the first have the fault of the parameters.
    """
    import fmpy

    ship = load_scenario("paper").vessel
    matrices = np.linalg.inv(ship.M), np.linalg.solve(ship.M, ship.D)
    lists = (",".join(map(repr, m.ravel().tolist())) for m in matrices)
    force, angle = (1.0, 1.0) if version == 2 else (1e3, np.pi / 180)
    values = dict(zip(("MINV", "MINV_D"), lists, strict=True))
    values |= {"FORCE": repr(force), "ANGLE": repr(float(angle)), "FMI": str(version)}
    values["COUNTER"] = f'"{counter}"'
    library, stubs = folder / f"ship{version}.so", folder / f"stubs{version}.c"
    stubs.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in list_stubs(version)))
    flags = [f"-D{name}={value}" for name, value in values.items()]
    command = [
        COMPILER,
        "-shared",
        "-fPIC",
        "-O2",
        *flags,
        str(SOURCE),
        str(stubs),
        "-o",
        str(library),
        "-lm",
    ]
    subprocess.run(command, check=True)
    place = fmpy.platform if version == 2 else fmpy.platform_tuple
    path = folder / f"ship{version}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(library, f"binaries/{place}/ship{fmpy.sharedLibraryExtension}")
        archive.writestr("modelDescription.xml", describe(version))
        archive.writestr("resources/none.txt", "")
    return path


def describe_otherwise(fmu: Path, folder: Path, text: str) -> Path:
    """Return a copy of an FMU with another model description, in a folder."""
    path = folder / fmu.name
    with zipfile.ZipFile(fmu) as own, zipfile.ZipFile(path, "w") as archive:
        for name in own.namelist():
            archive.writestr(name, text if name == "modelDescription.xml" else own.read(name))
    return path


def write_scenario(folder: Path, fmu: str, *, extra: str = "", weather: bool = True) -> Path:
    """Return the scenario `paper` with an FMU for its ship, as a file in a folder."""
    own = load_scenario("paper").environment
    rows = (
        [
            f"{name}{i} = {values[i]!r}"
            for name, values in (
                ("amplitude", own.amplitude.tolist()),
                ("period", own.period_s.tolist()),
                ("phase", own.phase_rad.tolist()),
            )
            for i in range(3)
        ]
        if weather
        else []
    )
    text = (
        f"""
title = "The paper's case with an FMU"
shows = "An FMU in place of the ship."
vessel = "supply_fs99"
sample_s = 0.3
duration_s = 300.0

[start]
north_m = 1.2
east_m = 1.3

[environment]

[controller]
tuning = "paper"
prediction_horizon = 30
control_horizon = 5
output_weight = [1.0, 1.0, 100.0]
move_weight = [1e-10, 1e-10, 1e-14]

[plant.fmu]
file = "{fmu}"
inputs = {{ surge = "Fx", sway = "Fy", yaw = "Mz" }}
outputs = {{ surge = "u", sway = "v", yaw = "r", north = "n", east = "e", heading = "psi" }}
start = {{ north = "n0", east = "e0", heading = "psi0" }}
{extra}

[plant.fmu.parameters]
"""
        + "\n".join(rows)
        + "\n"
    )
    path = folder / "case.toml"
    path.write_text(text)
    return path

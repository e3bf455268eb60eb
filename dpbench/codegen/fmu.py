"""The controller as a functional mock-up unit (FMU): FMI 2.0 or 3.0, co-simulation.

An FMU is a zip file with a model description, the sources, and a shared library for each system,
made by one cross-compiler.
"""

import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

from dpbench.codegen.c_tables import format_number_for_c, render_c_template
from dpbench.codegen.controller_data import ControllerData, Signal, make_unique_c_identifiers
from dpbench.embedded.toolchain import compile_library
from dpbench.temporary_folders import make_temporary_folder_for_block, process_temporary_folder

SYSTEMS = {
    2: (
        ("linux64", "x86_64-linux-gnu", ".so"),
        ("win64", "x86_64-windows-gnu", ".dll"),
        ("darwin64", "x86_64-macos", ".dylib"),
    ),
    3: (
        ("x86_64-linux", "x86_64-linux-gnu", ".so"),
        ("x86_64-windows", "x86_64-windows-gnu", ".dll"),
        ("x86_64-darwin", "x86_64-macos", ".dylib"),
        ("aarch64-darwin", "aarch64-macos", ".dylib"),
    ),
}
"""Platforms of an FMU by version: folder in the FMU, system for the compiler, ending of a shared
library."""
UNITS = (
    ("m", 'm="1"'),
    ("rad", 'rad="1"'),
    ("m/s", 'm="1" s="-1"'),
    ("rad/s", 'rad="1" s="-1"'),
    ("N", 'kg="1" m="1" s="-2"'),
    ("N.m", 'kg="1" m="2" s="-2"'),
)
_OWN_OUTPUTS = (
    Signal("status", "status", "", "0 solved, 1 inaccurate, 2 fallback, 3 bad input", 0, True),
    Signal("iterations", "iterations", "", "iterations of the solver", 0, True),
    Signal("clipped", "clipped", "", "1: the planned move was cut to the limits", 0, True),
)
_NEVER_CHANGED = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Variable:
    """Variable of an FMU: that of a signal, with value reference, direction and C expression."""

    name: str
    reference: int
    causality: str
    place: str
    unit: str
    meaning: str
    start: str
    is_integer: bool


def list_fmu_variables(data: ControllerData) -> list[Variable]:
    """Return the variables of a controller: inputs, commands, then status and iterations."""
    outputs = (*data.outputs, *_OWN_OUTPUTS)
    directions = [("input", s) for s in data.inputs] + [("output", s) for s in outputs]
    return [
        Variable(
            signal.name,
            reference,
            direction,
            f"{direction}.{signal.field}",
            signal.unit,
            escape(signal.meaning),
            str(int(signal.start)) if signal.is_integer else format_number_for_c(signal.start),
            signal.is_integer,
        )
        for reference, (direction, signal) in enumerate(directions)
    ]


def build_fmu_bytes(data: ControllerData, sources: Mapping[str, bytes], version: int) -> bytes:
    """Return the FMU of a controller; SituationError without ziglang or where it refuses.

    sources : the controller's files by name; its example and build files are left out.
    """
    (identifier,) = make_unique_c_identifiers([f"dpbench {data.scenario.name}"])
    own = {name: text for name, text in sources.items() if name.endswith((".c", ".h"))}
    del own["main.c"]
    variables = list_fmu_variables(data)
    values: dict[str, Any] = {
        "name": escape(data.scenario.name),
        "identifier": identifier,
        "description": escape(
            f"DP controller, {data.scenario.controller.tuning_horizons_and_command_text}"
        ),
        "sample_s": format_number_for_c(data.scenario.sample_s),
        "variables": variables,
        "inputs": data.inputs,
        "input_count": len(data.inputs),
        "numbers": [v for v in variables if not v.is_integer],
        "integers": [v for v in variables if v.is_integer],
        "time": len(variables),
        "units": UNITS,
    }
    own["fmu_instance.h"] = own["fmu.c"] = b""
    values["files"] = sorted(name for name in own if name.endswith(".c"))
    seed = [str([asdict(v) for v in variables]).encode(), *(own[name] for name in sorted(own))]
    token = hashlib.sha256(b"".join([str(version).encode(), *seed])).hexdigest()[:32]
    # The form of a GUID, which some importers demand.
    lengths, cuts = (8, 4, 4, 4, 12), (0, 8, 12, 16, 20)
    parts = [token[cut : cut + n] for cut, n in zip(cuts, lengths, strict=True)]
    values["token"] = "{" + "-".join(parts) + "}"
    own["fmu_instance.h"] = render_c_template("fmu_instance.h", **values)
    own["fmu.c"] = render_c_template(f"fmi{version}.c", **values)
    files = {"modelDescription.xml": render_c_template(f"fmi{version}.xml", **values)}
    if version == 3:
        files["sources/buildDescription.xml"] = render_c_template("build.xml", **values)
    files |= {f"sources/{name}": text for name, text in own.items()}
    files |= _compile_libraries_of_all_systems(own, identifier, version)
    return _zip_files_reproducibly(files)


def _compile_libraries_of_all_systems(
    sources: Mapping[str, bytes], identifier: str, version: int
) -> dict[str, bytes]:
    """Return the shared library for each system by its path in the FMU."""
    libraries: dict[str, bytes] = {}
    with make_temporary_folder_for_block(process_temporary_folder()) as folder:
        for name, text in sources.items():
            (folder / name).write_bytes(text)
        files = sorted(folder.glob("*.c"))
        for place, triple, ending in SYSTEMS[version]:
            out = folder / f"{place}{ending}"
            compile_library(files, triple, out)
            libraries[f"binaries/{place}/{identifier}{ending}"] = out.read_bytes()
    return libraries


def _zip_files_reproducibly(files: Mapping[str, bytes]) -> bytes:
    """Return files as a zip file, the same for the same files."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            archive.writestr(
                zipfile.ZipInfo(name, _NEVER_CHANGED), files[name], zipfile.ZIP_DEFLATED
            )
    return whole.getvalue()

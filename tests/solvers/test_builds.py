"""The build of a library is read from the library, not asserted."""

import ctypes
import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from dpbench.solvers.contract import Build, find_instruction_set_of_library
from dpbench.solvers.libraries.hpipm_library import (
    CASADI,
    VARIABLE,
    read_instruction_set_of_blasfeo,
)
from dpbench.solvers.table import Availability, find_solver_availability

AVX2, FMA = 0x2, 0x4

IS_NAMED = (os.environ.get(VARIABLE) or CASADI) != CASADI
"""True if the variable names a file with a BLASFEO."""


class Blasfeo:
    """A BLASFEO compiled for a target, by the functions of `blasfeo_processor_features.h`."""

    def __init__(self, features: int, text: bytes) -> None:
        self._features, self._text = features, text

    def blasfeo_processor_library_features(self, target: object) -> None:
        ctypes.cast(target, ctypes.POINTER(ctypes.c_int))[0] = self._features  # type: ignore[arg-type] # a reference

    def blasfeo_processor_library_string(self, target: ctypes.Array[ctypes.c_char]) -> None:
        target.value = self._text


@pytest.mark.parametrize(
    ("library", "build"),
    [
        (Blasfeo(0, b""), Build("BLASFEO generic", generic=True)),
        (Blasfeo(AVX2 | FMA, b" AVX2 FMA"), Build("BLASFEO AVX2 FMA")),
        (object(), Build()),
    ],
)
def test_a_blasfeo_is_generic_where_it_needs_no_vector_instruction(
    library: object, build: Build
) -> None:
    assert read_instruction_set_of_blasfeo(library) == build


@pytest.mark.skipif(not find_solver_availability("hpipm").ok, reason="casadi is not installed")
@pytest.mark.skipif(IS_NAMED, reason="the headers of a BLASFEO that is named are not known")
@pytest.mark.parametrize("solver", ["hpipm", "hpipm_ocp"])
def test_the_build_of_hpipm_is_that_of_the_headers_beside_it(solver: str) -> None:
    build = find_solver_availability(solver).build
    header = Path(str(import_module("casadi").__file__)).parent / "include" / "blasfeo_target.h"
    if "comma-deps-acados" in build.text:
        installed = Path(str(import_module("acados").__file__)).parent / "install"
        header = installed / "include" / "blasfeo" / "include" / "blasfeo_target.h"
    target = "#define TARGET_GENERIC" in header.read_text(encoding="utf-8")
    assert build.generic is target
    assert not find_solver_availability("qpoases").build.generic


@pytest.mark.parametrize(
    ("solver", "loaded"), [("piqp", "piqp_python"), ("proxqp", "proxsuite_pywrap")]
)
def test_a_build_chosen_at_import_is_the_one_in_memory(solver: str, loaded: str) -> None:
    text = find_solver_availability(solver).build.text
    end = {"AVX-512": "_avx512", "AVX2": "_avx2", "no AVX": ""}[text]
    maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    mapped = {Path(line.split()[-1]).name for line in maps.splitlines()}
    assert {name.partition(".")[0] for name in mapped if loaded in name} == {loaded + end}


@pytest.mark.parametrize(("end", "text"), [("_avx2", "AVX2"), ("", "no AVX")])
def test_a_lesser_processor_has_a_lesser_build(
    end: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_instruction_set_of_library("absent.library") == Build()
    monkeypatch.setitem(sys.modules, f"absent.library{end}", ModuleType("library"))
    assert find_instruction_set_of_library("absent.library") == Build(text)


def test_results_of_one_build_are_not_those_of_another() -> None:
    versions = [Availability(True, "1.0", build=Build(text)) for text in ("", "AVX2", "AVX-512")]
    assert len({each.version_and_build_text for each in versions}) == 3
    assert versions[0].version_and_build_text == "1.0"

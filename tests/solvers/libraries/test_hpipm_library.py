"""The BLASFEO under HPIPM: what may take the place of casadi's, and equal answers on both."""

import json
import subprocess
import weakref
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.solvers.libraries.hpipm_library import (
    ACADOS_PACKAGE,
    CASADI,
    VARIABLE,
    find_fault_of_blasfeo,
    load_hpipm,
    make_c_pointer_to_array,
)
from dpbench.solvers.own.compiling import find_c_compiler_command
from dpbench.solvers.table import find_solver_availability
from tests.solvers.conftest import run_program

needs_both_builds = pytest.mark.skipif(
    ACADOS_PACKAGE not in find_solver_availability("hpipm").build.text,
    reason="HPIPM is not installed with two builds of BLASFEO",
)

BLASFEO = """
struct dmat { double *mem, *pA, *dA; int m, n, pm, cn, use_dA, memsize; };
struct dvec { double *mem, *pa; int m, pm, memsize; };
static int up(int n, int to) { return (n + to - 1) / to * to; }
unsigned long blasfeo_memsize_dmat(int m, int n) { return 8UL * up(m, PANEL) * up(n, PANEL); }
unsigned long blasfeo_memsize_dvec(int m) { return 8UL * up(m, PANEL); }
void blasfeo_create_dmat(int m, int n, struct dmat *A, double *memory) {
    int pm = up(m, PANEL), cn = up(n, PANEL);
    *A = (struct dmat){memory, memory, memory + pm * cn, m, n, pm, cn, 0, 8 * pm * cn};
}
void blasfeo_create_dvec(int m, struct dvec *x, double *memory) {
    *x = (struct dvec){memory, memory, m, up(m, PANEL), 8 * up(m, PANEL)};
}
void blasfeo_processor_library_features(int *features) { *features = FEATURES; }
int blasfeo_processor_cpu_features(int *features) { *features = 0xf; return 1; }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("blasfeo")


@cache
def make_blasfeo(folder: Path, panel: int, features: int) -> Path:
    """A library with matrices in panels of so many rows, for a processor with these features."""
    source, library = folder / "blasfeo.c", folder / f"libblasfeo_{panel}_{features}.so"
    source.write_text(BLASFEO, encoding="utf-8")
    flags = ["-shared", "-fPIC", f"-DPANEL={panel}", f"-DFEATURES={features}"]
    subprocess.run([*find_c_compiler_command(), *flags, "-o", library, source], check=True)
    return library


@pytest.mark.slow
@pytest.mark.parametrize(
    ("panel", "features", "fault"),
    [
        (4, 0x6, ""),
        (8, 0x6, "its matrices have another layout in memory than casadi's"),
        (4, 0x10, "this processor lacks instructions that it uses"),
    ],
)
def test_another_blasfeo_needs_equal_structures_and_a_processor_for_it(
    panel: int, features: int, fault: str, folder: Path
) -> None:
    known = make_blasfeo(folder, 4, 0)
    assert find_fault_of_blasfeo(make_blasfeo(folder, panel, features), known) == fault
    loaded = Path("/proc/self/maps").read_text(encoding="utf-8")
    assert str(folder) not in loaded


def test_a_pointer_keeps_its_array_alive() -> None:
    array = np.arange(1000)
    pointer, alive = make_c_pointer_to_array(array), weakref.ref(array)
    del array
    assert pointer and alive() is not None


def test_a_file_that_is_no_blasfeo_is_a_fault(tmp_path: Path) -> None:
    text = tmp_path / "libblasfeo.so"
    text.write_text("none", encoding="utf-8")
    assert str(text) in find_fault_of_blasfeo(text, text)


@pytest.mark.skipif(not find_solver_availability("hpipm").ok, reason="casadi is not installed")
def test_a_named_file_that_is_missing_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "/missing/libblasfeo.so")
    load_hpipm.cache_clear()
    with pytest.raises(InputError, match=f'^{VARIABLE}: found /missing.*BLASFEO, or "casadi"$'):
        load_hpipm()


@needs_both_builds
@pytest.mark.slow
def test_both_builds_give_equal_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    program = """
import json
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import find_solver_availability
from tests.solvers.libraries.test_hpipm_ocp import Staged, TIGHT, solve_next
answers = []
for solver in ("hpipm", "hpipm_ocp"):
    case = Staged(4, 12, 3)
    workspace = open_workspace(solver, route="native", policy="warm", settings=TIGHT)
    workspace.setup(case.base)
    for _ in range(5):
        answer = solve_next(workspace, case.step())
        answers += [answer.iterations, *answer.z.tolist()]
print(json.dumps([find_solver_availability("hpipm").build.text, answers]))
"""
    builds, answers = [], []
    for named in (CASADI, ""):
        monkeypatch.setenv(VARIABLE, named)
        build, numbers = json.loads(run_program(program))
        builds.append(build)
        answers.append(numbers)
    assert builds[0] == "BLASFEO generic"
    assert builds[1].startswith(f"BLASFEO AVX2 FMA of {ACADOS_PACKAGE} ")
    np.testing.assert_allclose(answers[1], answers[0], rtol=0, atol=1e-9)

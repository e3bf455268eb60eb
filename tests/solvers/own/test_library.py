"""The C library: what a controller compiles, and what a user reads where it is missing."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dpbench.errors import SolverUnavailableError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own import compiling, library
from tests.solvers.conftest import solve_next, solve_qp

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O2")
# On the target all memory is static; with an argument the memory of the step is apart.
MAIN = """
#include <stdio.h>
#include "active_set.h"

static as_real reals[ACTIVE_SET_REALS(2, 1)];
static int integers[ACTIVE_SET_INTEGERS(2, 1)];
static as_real step_reals[ACTIVE_SET_STEP_REALS(2, 1)];
static int step_integers[ACTIVE_SET_STEP_INTEGERS(2, 1)];

int main(int argc, char **names)
{
    static const as_real P[4] = {1, 0, 0, 1}, A[2] = {1, 1};
    active_set s;
    active_set_place(&s, 2, 1, reals, integers);
    if (active_set_factorise(&s, P, A)) return 1;
    if (argc > 1 && names) active_set_place_step(&s, step_reals, step_integers);
    s.low[0] = s.low[1] = s.low[2] = -10;
    s.high[0] = s.high[1] = 1;
    s.high[2] = (as_real)2.5;
    s.q[0] = s.q[1] = -3;
    printf("%d", active_set_solve(&s));
    for (int i = 0; i < 2; i++) printf(" %.6f", (double)s.z[i]);
    for (int i = 0; i < 3; i++) printf(" %.6f", (double)s.lam[i]);
    return 0;
}
"""


# Random QPs of several sizes, whose rows may repeat, contradict each other or have crossed limits,
# with new rows, a new P and NaN. Each array has exactly the length that the header asks for.
SANITIZED = """
#include "hildreth.c"

#include <stdio.h>
#include <stdlib.h>

static unsigned state = 1;
static as_real draw(void) {
    state = state * 1664525u + 1013904223u;
    return (as_real)(state >> 8) / 8388608 - 1;
}

static void draw_cost(as_real *P, int n) {
    for (int i = 0; i < n; i++)
        for (int c = 0; c <= i; c++)
            P[i * n + c] = P[c * n + i] = i == c ? n : (i + c) % 3 ? draw() : 0;
}

static void draw_rows(as_real *A, int n, int m) {
    for (int i = 0; i < m * n; i++) A[i] = draw() > 0 ? draw() : 0;
    for (int c = 0; m > 1 && c < n; c++) A[n + c] = state % 2 ? A[c] : -A[c];
}

static void draw_step(active_set *s) {
    for (int i = 0; i < s->n; i++) s->q[i] = (as_real)s->n * 2 * draw();
    for (int i = 0; i < s->n + s->m; i++) {
        const as_real middle = draw() / 2, half = draw() + (as_real)0.9;
        s->low[i] = half > 1 ? -(as_real)INFINITY : middle - half;
        s->high[i] = half > (as_real)1.5 ? (as_real)INFINITY : middle + half * (state % 7 > 0);
    }
}

int main(void) {
    int endings[ACTIVE_SET_FAILED * -1 + 1] = {0};
    for (int trial = 0; trial < 400; trial++) {
        const int n = 1 + trial % 9, m = trial % 13;
        as_real *P = malloc(sizeof *P * (size_t)(n * n));
        as_real *A = malloc(sizeof *A * (size_t)(m * n + 1));
        as_real *reals = malloc(sizeof *reals * (size_t)ACTIVE_SET_REALS(n, m));
        as_real *change = malloc(sizeof *change * (size_t)(n + m));
        int *integers = malloc(sizeof *integers * (size_t)ACTIVE_SET_INTEGERS(n, m));
        active_set s;
        draw_cost(P, n);
        draw_rows(A, n, m);
        active_set_place(&s, n, m, reals, integers);
        if (active_set_factorise(&s, P, A)) return 1;
        s.warm = trial % 3 > 0;
        for (int k = 0; k < 12; k++) {
            if (k == 5) draw_rows(A, n, m);
            if (k == 5 && active_set_replace_rows(&s, A)) return 1;
            if (k == 8) draw_cost(P, n);
            if (k == 8 && active_set_factorise(&s, P, A)) return 1;
            draw_step(&s);
            if (k == 11) s.q[0] = (as_real)NAN;
            const int ending = trial % 5 ? active_set_solve(&s)
                                         : hildreth_solve(&s, 200, (as_real)1e-8, 1, change);
            endings[ending < 0 ? -ending : 0]++;
        }
        free(P), free(A), free(reals), free(change), free(integers);
    }
    for (int i = 0; i < 5; i++) printf("%d ", endings[i]);
    return 0;
}
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here")
@pytest.mark.parametrize("precision", [(), ("-DACTIVE_SET_FLOAT",)])
def test_a_sanitizer_finds_nothing_in_random_problems(
    precision: tuple[str, ...], tmp_path: Path
) -> None:
    """Under the address and undefined-behaviour sanitizers, with every kind of ending."""
    main, program = tmp_path / "main.c", tmp_path / "main"
    main.write_text(SANITIZED, encoding="utf-8")
    options = "-std=c99", "-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
    flags = (*options, *precision, f"-I{compiling.FOLDER}", "-o", str(program))
    subprocess.run(["gcc", *flags, str(main), "-lm"], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Solved, not finite, crossed, infeasible, inaccurate.
    assert all(int(count) > 0 for count in done.stdout.split())


@pytest.mark.slow
@pytest.mark.parametrize("precision", [(), ("-DACTIVE_SET_FLOAT",)])
def test_it_compiles_without_a_warning_and_solves_the_example_of_its_head(
    precision: tuple[str, ...], tmp_path: Path
) -> None:
    try:
        compiler = compiling.find_c_compiler_command()
    except RuntimeError as error:
        pytest.skip(str(error))
    main, program = tmp_path / "main.c", tmp_path / "main"
    main.write_text(MAIN, encoding="utf-8")
    sources = [str(main), str(compiling.FOLDER / "active_set_setup.c")]
    flags = (*STRICT, *precision, f"-I{compiling.FOLDER}", "-o", str(program))
    subprocess.run([*compiler, *flags, *sources, "-lm"], check=True)
    for arguments in ([], ["step"]):
        command = [str(program), *arguments]
        found = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        numbers = [float(text) for text in found.split()]
        np.testing.assert_allclose(numbers, [4, 1, 1, 2, 2, 0], rtol=0, atol=1e-5)


def test_a_multiplier_that_gets_the_wrong_sign_leaves_the_set_on_the_way() -> None:
    """The second example that the source works out by hand."""
    none = np.full(2, np.inf)
    base = QuadraticProgram(np.eye(2), [-2, -1], [[-1, 1]], [-9], [0], -none, [0, 9])
    workspace = open_workspace("paper_active_set", policy="warm")
    first = solve_qp(workspace, base)
    np.testing.assert_allclose([*first.y_box, *first.y], [3, 0, 1], rtol=0, atol=1e-12)
    second = solve_next(workspace, QPStep(np.array([-1.0, 2.0]), base.l, base.u))
    assert second.iterations == 1
    np.testing.assert_allclose([*second.z, *second.y_box, *second.y], [0, -2, 1, 0, 0], atol=1e-12)


def test_an_active_limit_that_becomes_infinite_is_left() -> None:
    """By hand: nearest to (2, 1) under z₀ + z₁ ≤ 1 is (1, 0); without that row it is (2, 1)."""
    none = np.full(2, np.inf)
    base = QuadraticProgram(np.eye(2), [-2, -1], [[1, 1]], [-np.inf], [1], -none, none)
    workspace = open_workspace("paper_active_set", policy="warm")
    np.testing.assert_allclose(solve_qp(workspace, base).z, [1, 0], rtol=0, atol=1e-12)
    free = solve_next(workspace, QPStep(base.q, base.l, np.array([np.inf])))
    np.testing.assert_allclose([*free.z, *free.y], [2, 1, 0], rtol=0, atol=1e-12)


def test_a_missing_library_without_a_compiler_is_one_line_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("DPBENCH_CC", "no-such-compiler")
    monkeypatch.setattr(compiling, "make_library_file_name", lambda: "_own_missing.so")
    with pytest.raises(SolverUnavailableError, match=re.escape(compiling.REMEDY)) as error:
        library.load_own_c_library.__wrapped__()
    assert "found no C compiler 'no-such-compiler'; run `pip install" in str(error.value)


@pytest.mark.slow
def test_a_folder_without_the_library_gets_it(tmp_path: Path) -> None:
    path = compiling.compile_own_library_if_missing(tmp_path / "new")
    assert (
        [path.name]
        == [each.name for each in path.parent.iterdir()]
        == [compiling.make_library_file_name()]
    )

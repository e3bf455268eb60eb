"""The harness's own configurations: what they do, and that no list of solvers has them."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from dpbench.errors import InputError, PolicyError, UnknownNameError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.calibration import (
    CALIBRATION,
    COPY_ONLY,
    NO_OP,
    BusyWaitWorkspace,
    CopyOnlyWorkspace,
)
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import (
    find_solver_record,
    list_all_solver_names,
    load_plugin_solver_from_file,
)
from tests.solvers.conftest import solve_next


@pytest.fixture
def qp() -> QuadraticProgram:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((2, 3))
    box = np.ones(3)
    return QuadraticProgram(np.eye(3), rng.standard_normal(3), A, -box[:2], box[:2], -box, box)


def test_they_have_names_but_are_no_solvers() -> None:
    assert not set(CALIBRATION) & set(list_all_solver_names())
    assert all(find_solver_record(name).name == name for name in CALIBRATION)
    with pytest.raises(UnknownNameError):
        find_solver_record("busy_wait_30us")


def test_no_plug_in_takes_their_name(tmp_path) -> None:
    text = Path(__file__).with_name("example_plugin.py").read_text(encoding="utf-8")
    (tmp_path / "mine.py").write_text(text.replace('"admm", m', f'"{NO_OP}", m'), encoding="utf-8")
    with pytest.raises(InputError, match=NO_OP):
        load_plugin_solver_from_file(tmp_path / "mine.py")


@pytest.mark.parametrize("name", CALIBRATION)
def test_they_run_one_way_and_claim_nothing(name: str, qp: QuadraticProgram) -> None:
    with pytest.raises(PolicyError, match="reuse"):
        open_workspace(name)
    workspace = open_workspace(name, policy="reuse")
    workspace.setup(qp)
    answer = solve_next(workspace, QPStep(qp.q, qp.l, qp.u))
    assert (answer.status, answer.iterations) == (Status.UNKNOWN, -1)
    assert np.isnan(answer.z).all() and answer.z.shape == (3,) and answer.y.shape == (2,)
    assert (workspace.read() is answer) == (name != COPY_ONLY)


def test_copy_only_copies_in_and_out(qp: QuadraticProgram) -> None:
    workspace = CopyOnlyWorkspace(COPY_ONLY)
    workspace.setup(qp)
    step = QPStep(qp.q + 1, qp.l - 1, qp.u + 2)
    workspace.update(step)
    for copied, given in ((workspace.q, step.q), (workspace.l, step.l), (workspace.u, step.u)):
        np.testing.assert_array_equal(copied, given)
        assert not np.shares_memory(copied, given)
    first, second = workspace.read(), workspace.read()
    for a, b in ((first.z, second.z), (first.y, second.y), (first.y_box, second.y_box)):
        assert not np.shares_memory(a, b)
    assert not np.shares_memory(first.z, first.y_box)


@pytest.mark.parametrize("wait_ns", [20_000, 1_000_000])
def test_a_wait_ends_with_the_first_reading_that_is_late_enough(wait_ns: int) -> None:
    """On a clock that advances 300 ns a reading it reads as often as the wait holds such steps."""
    readings = itertools.count(5_000, 300)
    workspace = BusyWaitWorkspace("busy", wait_ns, lambda: next(readings))
    workspace.solve()
    took = next(readings) - 300 - 5_000
    assert wait_ns <= took < wait_ns + 300

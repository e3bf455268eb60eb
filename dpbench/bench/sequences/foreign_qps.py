"""QPs in formats of others: OCP QPs dumped by acados (.json), Maros-Meszaros problems (.mat).

acados: `AcadosOcpSolver.dump_last_qp_to_json` writes each array of stage k as `field_k`. The stages
are written as one sparse QP of z = [u_0, x_0, …, u_N, x_N]:

    minimise Σ ½ [u; x]ᵀ [R S; Sᵀ Q] [u; x] + rᵀu + qᵀx
    subject to x_{k+1} = A x_k + B u_k + b,  lg ≤ C x_k + D u_k ≤ ug,  bounds of u_k and x_k

`idxb` numbers the bounded entries of [u; x], as HPIPM does; older versions of acados do not write
it.

Maros-Meszaros: `.mat` files of the proxqp benchmark, P, q, A, l, u, whose last n rows of A are the
identity, for the bounds.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Floats, Matrix, Vector
from dpbench.bench.record.npz import Arrays, read_float_array
from dpbench.errors import InputError
from dpbench.files.mat import read_mat_structure_in_child
from dpbench.files.regular_files import read_json_object
from dpbench.qp.program import QuadraticProgram, require_or_make_symmetric

ACADOS_WRITER = "`AcadosOcpSolver.dump_last_qp_to_json`"
ACADOS = f"an OCP QP of {ACADOS_WRITER} (.json)"
ACADOS_INFINITY, MAT_INFINITY = 0.99e10, 9e19
"""Size from which a limit is none. acados has 1e10, less the state that it linearises at."""
MOST_VARIABLES = 2000
"""Largest QP that is read: its matrices are dense, P then has 32 MB."""
ONE_WAY = "the .mat, CSV and QPS exports of dpbench cannot be read back"
_MATRICES = ("A", "B", "Q", "R", "S", "C", "D")
_VECTORS = ("b", "q", "r", "lg", "ug", "lbx", "ubx", "lbu", "ubu", "idxb")
_SOFT = ("idxs", "zl", "zu", "Zl", "Zu")
_KEY = re.compile(r"([A-Za-z]+)_([0-9]{1,6})")


def read_acados_qp(path: Path) -> QuadraticProgram:
    """Return the OCP QP in a JSON file of acados as one sparse QP; InputError for a bad file."""
    where = str(path)
    stages = _Stages(_group_arrays_by_stage(read_json_object(path, ACADOS), where), where)
    n = stages.ends[-1]
    P, q, rows = np.zeros((n, n)), np.zeros(n), []
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    for k, (x, u) in enumerate(zip(stages.x, stages.u, strict=True)):
        nx, nu = len(x), len(u)
        P[np.ix_(u, u)], P[np.ix_(x, x)] = stages.read(k, "R", nu, nu), stages.read(k, "Q", nx, nx)
        P[np.ix_(u, x)] = S = stages.read(k, "S", nu, nx)
        P[np.ix_(x, u)] = S.T
        q[u], q[x] = stages.read(k, "r", nu), stages.read(k, "q", nx)
        at = np.concatenate((u, x))[stages.read_bounded_entries(k, nu, nx)]
        lb[at], ub[at] = (
            np.concatenate([stages.read_limits(k, f"{side}{of}") for of in "ux"])
            for side in ("lb", "ub")
        )
        if k + 1 < len(stages.x):
            after = stages.x[k + 1]
            row, b = np.zeros((len(after), n)), stages.read(k, "b", len(after))
            row[:, after], row[:, x] = np.eye(len(after)), -stages.read(k, "A", len(after), nx)
            row[:, u] = -stages.read(k, "B", len(after), nu)
            rows.append((row, b, b))
        low, high = stages.read_limits(k, "lg"), stages.read_limits(k, "ug")
        row = np.zeros((len(low), n))
        row[:, x] = stages.read(k, "C", len(low), nx)
        row[:, u] = stages.read(k, "D", len(low), nu)
        rows.append((row, low, high))
    A, low, high = (np.concatenate(part) for part in zip(*rows, strict=True))
    return QuadraticProgram(require_or_make_symmetric(P, where), q, A, low, high, lb, ub)


def _group_arrays_by_stage(document: dict[str, object], where: str) -> list[Arrays]:
    """Return the arrays of each stage by field; InputError for unknown fields or soft limits."""
    by_stage: dict[int, Arrays] = {}
    for key, value in document.items():
        match = _KEY.fullmatch(key)
        field = match[1] if match else ""
        if match is None or field not in (*_MATRICES, *_VECTORS, *_SOFT):
            raise InputError(where, key[:80], "an unknown field", f"the fields of {ACADOS_WRITER}")
        try:
            array = np.array(value)
        except ValueError as error:
            raise InputError(where, key, "lists of unequal length", "a matrix") from error
        if field in _SOFT:
            if array.size:
                raise InputError(where, key, "soft constraints", "a QP without slacks")
            continue
        shaped = array.reshape(-1) if field in _VECTORS else array
        by_stage.setdefault(int(match[2]), {})[field] = shaped
    if sorted(by_stage) != list(range(len(by_stage))) or not by_stage:
        raise InputError(
            where,
            "",
            "a QP without some of its stages" if by_stage else "no stages",
            f"all stages 0 to N of {ACADOS}",
        )
    return [by_stage[k] for k in range(len(by_stage))]


class _Stages:
    """Checked access to the arrays of the stages of an OCP QP.

    x, u : places of the states and inputs of each stage in z; ends : of each stage in z.
    """

    def __init__(self, stages: list[Arrays], where: str) -> None:
        self._stages, self._where = stages, where
        sizes = [
            [len(stage[name]) if name in stage and stage[name].ndim else 0 for name in ("R", "Q")]
            for stage in stages
        ]
        self.ends = np.cumsum([nu + nx for nu, nx in sizes]).tolist()
        if not 1 <= self.ends[-1] <= MOST_VARIABLES:
            found = f"{self.ends[-1]} states and inputs over all stages"
            raise InputError(where, "Q, R", found, f"1 to {MOST_VARIABLES} in total")
        begins = [0, *self.ends[:-1]]
        self.u = [np.arange(at, at + nu) for at, (nu, _) in zip(begins, sizes, strict=True)]
        self.x = [np.arange(end - nx, end) for end, (_, nx) in zip(self.ends, sizes, strict=True)]

    def read(self, k: int, name: str, *shape: int, infinite: str = "") -> Floats:
        """Return an array of stage k; zeros of `shape` where acados leaves out an empty one."""
        if name not in self._stages[k] and 0 in shape:
            return np.zeros(shape)
        where = f"{self._where}, stage {k}"
        return read_float_array(self._stages[k], where, name, shape, infinite=infinite)

    def read_limits(self, k: int, name: str) -> Vector:
        """Return limits of stage k, infinite ones as ±inf; as many as the lower ones."""
        lower = self._stages[k].get(name.replace("u", "l", 1) if name[0] == "u" else name)
        found = self.read(k, name, 0 if lower is None else len(lower), infinite="+-")
        return _make_infinite(found, ACADOS_INFINITY)

    def read_bounded_entries(self, k: int, nu: int, nx: int) -> NDArray[np.intp]:
        """Return which entries of [u; x] of stage k have bounds."""
        counts = [len(self.read_limits(k, name)) for name in ("lbu", "lbx")]
        if "idxb" not in self._stages[k] and all(
            count in (0, size) for count, size in zip(counts, (nu, nx), strict=True)
        ):
            return np.arange(nu + nx)[nu * (not counts[0]) : nu + nx * bool(counts[1])]
        entries = self.read(k, "idxb", sum(counts))
        known = np.isin(entries, np.arange(nu + nx)).all()
        if not known or len(np.unique(entries)) != len(entries):
            allowed = f"distinct indices from 0 to {nu + nx - 1}"
            raise InputError(f"{self._where}, stage {k}", "idxb", "invalid entries", allowed)
        return entries.astype(np.intp)


def read_maros_meszaros_problem(path: Path) -> QuadraticProgram:
    """Return the QP in a Maros-Meszaros `.mat` file; InputError for a bad file."""
    where = str(path)
    _, arrays = read_mat_structure_in_child(path, "")
    if "y_box" in arrays:
        allowed = f"the .npz file of the same QPs, as {ONE_WAY}"
        raise InputError(where, "", "a file written by dpbench", allowed)
    # SciPy reads a single number as no array.
    arrays |= {name: arrays[name].reshape(-1) for name in ("q", "l", "u") if name in arrays}
    n = arrays["q"].size if "q" in arrays else 0
    m = arrays["l"].size - n if "l" in arrays else 0
    if not 1 <= n <= MOST_VARIABLES or m < 0:
        found, allowed = f"{n} variables and {m + n} limits", f"1 to {MOST_VARIABLES} variables"
        raise InputError(where, "q, l", found, f"{allowed}, and one limit per row and variable")
    arrays |= {name: np.atleast_2d(arrays[name]) for name in ("P", "A") if name in arrays}
    P, A = read_float_array(arrays, where, "P", (n, n)), _read_rows_and_bounds(arrays, where, m, n)
    q = read_float_array(arrays, where, "q", (n,))
    low, high = (
        _make_infinite(read_float_array(arrays, where, name, (m + n,), infinite="+-"), MAT_INFINITY)
        for name in ("l", "u")
    )
    P = require_or_make_symmetric(P, where)
    return QuadraticProgram(P, q, A, low[:m], high[:m], low[m:], high[m:])


def _read_rows_and_bounds(arrays: Arrays, where: str, m: int, n: int) -> Matrix:
    """Return the rows of A but the last n, which are the bounds'; InputError if they are not."""
    A = read_float_array(arrays, where, "A", (m + n, n))
    if (A[m:] != np.eye(n)).any():
        raise InputError(where, f"A[{m}:]", "another matrix", "the identity, for the bounds")
    return A[:m]


def _make_infinite(limits: Vector, size: float) -> Vector:
    """Return limits with those of at least some size as ±inf."""
    return np.where(np.abs(limits) >= size, np.copysign(np.inf, limits), limits)

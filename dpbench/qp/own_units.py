"""A recorded sequence in units of its own, made from its scaled form by a diagonal change of units.

    z_own = U z,  (A z)_own = W (A z),  U = diag(units.z),  W = diag(units.row)
    P_own = U⁻¹ P U⁻¹,  q_own = U⁻¹ q,  A_own = W A U⁻¹,  l_own = W l,  lb_own = U lb

The objective is the same number in both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dpbench.errors import ShapeError
from dpbench.qp.program import CONSTANT, QPSequence, QuadraticProgram, Units


def in_own_units(scaled: QPSequence, units: Units) -> QPSequence:
    """The same QPs in the units `units` stands for, with `scaled` as their scaled form.

    Parameters
    ----------
    scaled : a sequence in scaled units.
    units : z (n,) and row (m,), what 1 of a variable and of a row is in the other units.

    Raises
    ------
    ShapeError : for units of another size than the QPs.
    """
    base = scaled.base
    for name, factors, size in (("z", units.z, base.n), ("row", units.row, base.m)):
        if factors.shape != (size,):
            raise ShapeError.of("Units", name, factors.shape, f"shape {(size,)}")
    z, row = units.z, units.row
    factor: dict[str, Any] = {
        "P": 1.0 / np.outer(z, z),
        "q": 1.0 / z,
        "A": np.outer(row, 1.0 / z),
        "l": row,
        "u": row,
        "lb": z,
        "ub": z,
    }
    own = {name: getattr(base, name) * by for name, by in factor.items()}
    problem = QuadraticProgram(**own, block=base.block, moves=base.moves)
    # The same factors for all steps: they are those of the last axes.
    steps = {name: getattr(scaled, name) * factor[name] for name in ("q", "l", "u")}
    for name in CONSTANT:
        matrices = getattr(scaled, name)
        steps[name] = None if matrices is None else matrices * factor[name]
    return replace(
        scaled, base=problem, units=units, scaled=scaled, sparse_equivalent=None, **steps
    )

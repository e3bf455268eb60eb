"""The libraries through their own interfaces, one adapter each."""

from dpbench.solvers.native import (
    clarabel,
    daqp,
    highs,
    osqp,
    piqp,
    proxqp,
    qoco,
    qpalm,
    quadprog,
    scs,
)
from dpbench.solvers.native.adapter import NativeAdapter

NATIVE: dict[str, NativeAdapter] = {
    adapter.record.name: adapter
    for adapter in (
        clarabel.ADAPTER,
        daqp.ADAPTER,
        highs.ADAPTER,
        osqp.ADAPTER,
        piqp.ADAPTER,
        piqp.SPARSE_ADAPTER,
        proxqp.ADAPTER,
        proxqp.SPARSE_ADAPTER,
        qoco.ADAPTER,
        qpalm.ADAPTER,
        quadprog.ADAPTER,
        scs.ADAPTER,
    )
}

__all__ = ["NATIVE", "NativeAdapter"]

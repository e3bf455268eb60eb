"""The libraries through their own interfaces, one adapter each."""

from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.native import (
    clarabel,
    daqp,
    highs,
    osqp,
    piqp,
    proxqp,
    qoco,
    qpalm,
    qpoases,
    quadprog,
    scs,
)
from dpbench.solvers.native.hpipm import dense as hpipm
from dpbench.solvers.native.hpipm import ocp as hpipm_ocp

NATIVE: dict[str, NativeAdapter] = {
    adapter.record.name: adapter
    for adapter in (
        clarabel.ADAPTER,
        daqp.ADAPTER,
        highs.ADAPTER,
        hpipm.ADAPTER,
        hpipm_ocp.ADAPTER,
        osqp.ADAPTER,
        piqp.ADAPTER,
        piqp.SPARSE_ADAPTER,
        piqp.MULTISTAGE_ADAPTER,
        proxqp.ADAPTER,
        proxqp.SPARSE_ADAPTER,
        qoco.ADAPTER,
        qpalm.ADAPTER,
        qpoases.ADAPTER,
        quadprog.ADAPTER,
        scs.ADAPTER,
    )
}

__all__ = ["NATIVE", "NativeAdapter"]

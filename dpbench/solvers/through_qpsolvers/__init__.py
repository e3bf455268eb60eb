"""The libraries behind qpsolvers, one adapter each."""

from dpbench.solvers.adapter import Adapter
from dpbench.solvers.through_qpsolvers import (
    clarabel,
    coneqp,
    daqp,
    ecos,
    highs,
    on_jax,
    osqp,
    piqp,
    proxqp,
    pyqpmad,
    qpalm,
    qtqp,
    quadprog,
    scs,
    sip,
)

ADAPTERS: dict[str, Adapter] = {
    adapter.record.name: adapter
    for adapter in (
        clarabel.ADAPTER,
        coneqp.CVXOPT,
        daqp.ADAPTER,
        ecos.ADAPTER,
        highs.ADAPTER,
        on_jax.JAXOPT,
        coneqp.KVXOPT,
        osqp.ADAPTER,
        piqp.ADAPTER,
        proxqp.ADAPTER,
        pyqpmad.ADAPTER,
        qpalm.ADAPTER,
        on_jax.QPAX,
        qtqp.ADAPTER,
        quadprog.ADAPTER,
        scs.ADAPTER,
        sip.ADAPTER,
    )
}

__all__ = ["ADAPTERS", "Adapter"]

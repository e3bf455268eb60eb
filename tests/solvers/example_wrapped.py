"""A solver behind qpsolvers as a newcomer adds it: this file in `through_qpsolvers/`, no more."""

from dataclasses import replace

from dpbench.solvers.adapter import QpsolversAdapter
from dpbench.solvers.through_qpsolvers import quadprog

RECORD = replace(quadprog.RECORD, name="newcomer_wrapped", method="that of quadprog")
ADAPTER = replace(quadprog.ADAPTER, record=RECORD, qpsolvers_name="quadprog")
assert isinstance(ADAPTER, QpsolversAdapter)

"""A solver behind qpsolvers as a newcomer adds it: this file in `libraries/`, and nothing else."""

from dataclasses import replace

from dpbench.solvers.adapter import QpsolversAdapter
from dpbench.solvers.libraries import quadprog

ROUTES = {"qpsolvers": quadprog.RECORD.get_route_record("qpsolvers")}
RECORD = replace(quadprog.RECORD, name="newcomer_wrapped", method="that of quadprog", routes=ROUTES)
ADAPTER = replace(quadprog.THROUGH_QPSOLVERS, record=RECORD, qpsolvers_name="quadprog")
assert isinstance(ADAPTER, QpsolversAdapter)

"""What is counted of a cluster's workers, and which of them are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from dpbench.bench.engines.on_worker import about
from dpbench.errors import InputError

WHY = "engine dask needs the extra `cluster`"
dask_cluster = pytest.importorskip("dpbench.bench.engines.dask_cluster", reason=WHY)
EXCLUSIVE = dask_cluster.EXCLUSIVE
counted_anew, fleet_of = dask_cluster.counted_anew, dask_cluster.fleet_of


class Cluster:
    """A client of workers that are not there, one of a thread on each of some hosts."""

    def __init__(self, *hosts: str, exclusive: int = 0) -> None:
        self.status = "running"
        self.workers = {
            f"tcp://{host}:{i}": {
                "host": host,
                "nthreads": 1,
                "resources": {EXCLUSIVE: 1} if i < exclusive else {},
            }
            for i, host in enumerate(hosts)
        }
        self.said: Any = about()

    def wait_for_workers(self, count: int) -> None:
        assert len(self.workers) >= count

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": self.workers}

    def run(self, function: object, on_error: str) -> dict[str, Any]:
        return dict.fromkeys(self.workers, self.said)


def test_a_machine_offers_itself_once() -> None:
    """One worker of each machine may; two of one would time beside each other."""
    fleet = fleet_of(Cluster("a", "a", "b", exclusive=1))
    assert (fleet.exclusive, fleet.slots, fleet.concurrency) == (True, 3, 2)
    assert fleet_of(Cluster("a", "b", exclusive=2)).exclusive
    with pytest.raises(InputError, match="exclusive 2 times on a"):
        fleet_of(Cluster("a", "a", exclusive=2))


def test_a_worker_of_another_version_is_refused() -> None:
    """Before anything runs; so is one that may start no processes, or that has no dpbench."""
    cluster = Cluster("a")
    for said, found in (
        (replace(about(), harness_version="0.0.9"), r"with dpbench 0\.0\.9"),
        (replace(about(), may_start=False), "a daemon"),
        (ModuleNotFoundError("dpbench"), "without dpbench"),
    ):
        cluster.said = said
        with pytest.raises(InputError, match=found):
            fleet_of(cluster)


def test_workers_are_counted_anew() -> None:
    """Those that came and those that went; where the scheduler does not tell, nothing changes."""
    cluster = Cluster("a", "b")
    fleet = fleet_of(cluster)
    cluster.workers = Cluster("a", "a", "a", "b").workers
    grown = counted_anew(cluster, fleet)
    assert (grown.slots, grown.concurrency, grown.exclusive) == (4, 3, False)
    cluster.workers = Cluster("b").workers
    shrunk = counted_anew(cluster, grown)
    # The most there were at a time, beside whatever ran then.
    assert (shrunk.slots, shrunk.concurrency) == (1, 3)
    cluster.workers = {}
    assert counted_anew(cluster, grown) == grown
    cluster.workers, cluster.status = Cluster("a").workers, "connecting"
    assert counted_anew(cluster, grown) == grown

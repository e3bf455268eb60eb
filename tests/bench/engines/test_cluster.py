"""Count of a cluster's workers, and refusal of some of them."""

import re
from dataclasses import replace
from typing import Any

import pytest

from dpbench.bench.engines.on_worker import describe_worker
from dpbench.errors import InputError

WHY = "engine dask needs the extra `cluster`"
dask_cluster = pytest.importorskip("dpbench.bench.engines.dask_cluster", reason=WHY)
EXCLUSIVE = dask_cluster.EXCLUSIVE
Cluster = dask_cluster.Cluster


class Client:
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
        self.said: dict[str, Any] = {}

    def wait_for_workers(self, count: int) -> None:
        assert len(self.workers) >= count

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": self.workers}

    def run(self, function: object, workers: list[str], on_error: str) -> dict[str, Any]:
        return {address: self.said.get(address, describe_worker()) for address in workers}


def test_a_machine_offers_itself_once() -> None:
    cluster = Cluster(Client("a", "a", "b", exclusive=1))
    assert (cluster.exclusive, cluster.slots, cluster.concurrency) == (True, 3, 2)
    assert Cluster(Client("a", "b", exclusive=2)).exclusive
    with pytest.raises(InputError, match="the resource 'exclusive' 2 times on machine a"):
        Cluster(Client("a", "a", exclusive=2))


REFUSED = (
    (replace(describe_worker(), harness_version="0.0.9"), r"with dpbench 0\.0\.9"),
    (replace(describe_worker(), may_start=False), "a daemon"),
    (ModuleNotFoundError("dpbench"), "without dpbench"),
)


@pytest.mark.parametrize(("said", "found"), REFUSED)
def test_a_worker_of_another_version_is_refused(said: object, found: str) -> None:
    client = Client("a")
    client.said = {"tcp://a:0": said}
    with pytest.raises(InputError, match=found):
        Cluster(client)


@pytest.mark.parametrize(("said", "found"), REFUSED)
def test_a_late_worker_of_another_version_has_no_task(said: object, found: str) -> None:
    client = Client("a")
    cluster = Cluster(client)
    client.workers = Client("a", "b", "b").workers
    client.said = {"tcp://b:1": said}
    (remark,) = cluster.update_workers()
    assert re.search(f"is given no cells.*{found}", remark)
    assert cluster.addresses == {"tcp://a:0", "tcp://b:2"} and cluster.slots == 2
    assert cluster.update_workers() == []


def test_workers_are_counted_anew() -> None:
    client = Client("a", "b")
    cluster = Cluster(client)
    client.workers = Client("a", "a", "a", "b").workers
    cluster.update_workers()
    assert (cluster.slots, cluster.concurrency, cluster.exclusive) == (4, 3, False)
    client.workers = Client("b").workers
    cluster.update_workers()
    # The most there were at a time, beside whatever ran then.
    assert (cluster.slots, cluster.concurrency) == (1, 3)
    client.workers, before = {}, cluster.addresses
    cluster.update_workers()
    assert (cluster.slots, cluster.addresses) == (1, before)
    client.workers, client.status = Client("a", "a").workers, "connecting"
    cluster.update_workers()
    assert (cluster.slots, cluster.addresses) == (1, before)


def test_a_worker_that_does_not_answer_is_asked_again() -> None:
    client = Client("a")
    cluster = Cluster(client)
    client.workers = Client("a", "b").workers
    client.said = {"tcp://b:1": OSError("nobody there")}
    assert cluster.update_workers() == [] and cluster.addresses == {"tcp://a:0"}
    client.said = {}
    assert cluster.update_workers() == [] and cluster.slots == 2

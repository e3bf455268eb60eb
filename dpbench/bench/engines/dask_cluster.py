"""A Dask cluster: reached by the address of its scheduler, or made of processes of this machine."""

from __future__ import annotations

import logging
import socket
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dask
from distributed import Client, Nanny, Scheduler, SpecCluster
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend

from dpbench.bench.engines.on_worker import About, about
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.workers.child import without_main
from dpbench.errors import InputError
from dpbench.own_folders import own_folder

EXCLUSIVE = "exclusive"
"""The resource of which a machine's workers offer one together, if replays may be timed there."""
ANSWER_S = 5.0
"""How long a scheduler may take to answer."""
WHERE = "--scheduler"
_OWN = {
    # A worker that is a daemon could start no processes.
    "distributed.worker.daemon": False,
    # What a worker would look at itself for takes time from the cells beside it.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
}
"""Configuration of a cluster of this machine."""


@dataclass(frozen=True)
class Fleet:
    """The workers of a cluster.

    slots : tasks at a time; concurrency : the most of them on one machine so far.
    exclusive : whether one of them offered `EXCLUSIVE` when the campaign began.
    machine : that of the one that times replays; kinds : how many kinds of machines there were.
    """

    slots: int
    concurrency: int
    exclusive: bool
    machine: dict[str, Any]
    kinds: int


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """A client of the scheduler at an address; InputError where none answers."""
    with _quiet():
        try:
            _knock(address)
            client = Client(address, timeout=ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            found = f"{address}, where nobody answers ({type(error).__name__})"
            allowed = "the address of a Dask scheduler that runs, as tcp://HOST:8786"
            raise InputError(WHERE, "", found, allowed) from error
        with client:
            yield client


def _knock(address: str) -> None:
    """OSError or ValueError where nobody listens, which a client finds out only after long tries
    and leaves threads behind."""
    scheme, place = parse_address(address)
    get_backend(scheme)
    with socket.create_connection(parse_host_port(place), timeout=ANSWER_S):
        pass


@contextmanager
def own_cluster(workers: int) -> Iterator[Client]:
    """A client of so many workers on this machine, one of which times replays; the program that
    started the campaign is hidden meanwhile, for a worker may have to be started again at any
    time."""
    with (
        _quiet(),
        without_main(),
        own_folder(Path(tempfile.gettempdir())) as folder,
        dask.config.set(_OWN),
    ):
        plain = {
            "nthreads": 1,
            "memory_limit": 0,
            "dashboard": False,
            "local_directory": str(folder),
            "silence_logs": logging.CRITICAL,
        }
        spec = {
            i: {"cls": Nanny, "options": {**plain, "resources": {EXCLUSIVE: 1} if i == 0 else {}}}
            for i in range(workers)
        }
        options = {"host": "127.0.0.1", "dashboard": False, "dashboard_address": ":0"}
        scheduler = {"cls": Scheduler, "options": options}
        with (
            SpecCluster(spec, scheduler, silence_logs=logging.CRITICAL) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client


def fleet_of(client: Client) -> Fleet:
    """The workers of a cluster, waiting for the first of them.

    Raises
    ------
    InputError : for a worker that cannot run cells as they are here.
    """
    client.wait_for_workers(1)
    offered: Mapping[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    said = client.run(about, on_error="return")
    abouts = {address: _checked(address, answer) for address, answer in said.items()}
    workers = {address: offered[address] for address in abouts if address in offered}
    exclusive = [a for a, worker in workers.items() if worker["resources"].get(EXCLUSIVE, 0) >= 1]
    first = (exclusive or [*abouts])[0]
    offers: Counter[str] = Counter()
    for worker in workers.values():
        offers[worker["host"]] += worker["resources"].get(EXCLUSIVE, 0)
    if many := [host for host, count in offers.items() if count > 1]:
        found = f"resource {EXCLUSIVE} {offers[many[0]]:g} times on {many[0]}"
        raise InputError(WHERE, "", found, f"one worker of a machine with {EXCLUSIVE}=1")
    on_host = _threads(workers)
    return Fleet(
        slots=max(1, sum(on_host.values())),
        concurrency=max(1, *on_host.values()),
        exclusive=bool(exclusive),
        machine=abouts[first].machine,
        kinds=len({one.machine["id"] for one in abouts.values()}),
    )


def counted_anew(client: Client, fleet: Fleet) -> Fleet:
    """The fleet with the threads of the workers that are there now; as it was, where the scheduler
    does not tell or has none."""
    if client.status != "running":
        return fleet
    on_host = _threads(client.scheduler_info(n_workers=-1)["workers"])
    if not on_host:
        return fleet
    most = max(fleet.concurrency, *on_host.values())
    return replace(fleet, slots=sum(on_host.values()), concurrency=most)


def _threads(workers: Mapping[str, Any]) -> Counter[str]:
    """How many threads the workers of each machine have together."""
    on_host: Counter[str] = Counter()
    for worker in workers.values():
        on_host[worker["host"]] += int(worker["nthreads"])
    return on_host


def _checked(address: str, answer: object) -> About:
    """What a worker said of itself; InputError where it cannot run cells."""
    if not isinstance(answer, About):
        found = f"worker {address} without dpbench {HARNESS_VERSION} ({answer!r})"
        raise InputError(WHERE, "", found, "workers in the environment of the campaign")
    if answer.harness_version != HARNESS_VERSION:
        found = f"worker {address} with dpbench {answer.harness_version}"
        raise InputError(WHERE, "", found, f"dpbench {HARNESS_VERSION}, as here")
    if not answer.may_start:
        found = f"worker {address}, a daemon, which may start no processes"
        allowed = "workers started with DASK_DISTRIBUTED__WORKER__DAEMON=False"
        raise InputError(WHERE, "", found, allowed)
    return answer


@contextmanager
def _quiet() -> Iterator[None]:
    """What Dask would log of lost workers and connections; a campaign says it in its own words."""
    logger = logging.getLogger("distributed")
    levels = {handler: handler.level for handler in logger.handlers}
    try:
        for handler in levels:
            handler.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for handler, level in levels.items():
            handler.setLevel(level)

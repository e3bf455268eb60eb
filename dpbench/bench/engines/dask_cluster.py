"""A Dask cluster: reached by the address of its scheduler, or made of processes of this machine."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import dask
from cryptography import x509  # noqa: F401 # Dask makes certificates with it and looks late
from distributed import Client, Nanny, Scheduler, SpecCluster, Worker
from distributed.comm import connect
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend
from distributed.security import Security

from dpbench.bench.engines.engine import TlsFiles
from dpbench.bench.engines.on_worker import About, about, end_tasks
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.record.descriptions import MachineDescription
from dpbench.bench.workers.child import without_main
from dpbench.bench.workers.interrupts import signals_wait, terminal_signals_blocked
from dpbench.errors import InputError
from dpbench.temporary_folders import temporary_folder

EXCLUSIVE = "exclusive"
"""The resource of which a machine's workers offer one together, if replays may be timed there."""
ANSWER_S = 5.0
"""How long a scheduler may take to answer."""
WHERE, TLS = "--scheduler", "--tls"
_OWN = {
    # A worker that is a daemon could start no processes.
    "distributed.worker.daemon": False,
    # What a worker would look at itself for takes time from the cells beside it.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
}
"""Configuration of a cluster of this machine."""


LOOPBACK = "127.0.0.1"
"""Where all of a cluster of this machine listens."""


class _WithoutHttp:
    """A node of Dask whose pages nobody asked for: they have no TLS, and no option leaves them
    out."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """Listen nowhere."""


class OwnScheduler(_WithoutHttp, Scheduler):  # type: ignore[misc] # Dask is untyped here
    """The scheduler of a cluster of this machine."""


class OwnWorker(_WithoutHttp, Worker):  # type: ignore[misc] # Dask is untyped here
    """A worker of a cluster of this machine."""

    async def close(self, *args: Any, **kwargs: Any) -> Any:
        """Dask would wait for its task for some seconds, then kill it with what lies around it."""
        end_tasks()
        return await super().close(*args, **kwargs)


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
    machine: MachineDescription
    kinds: int


@contextmanager
def connected(address: str, tls: TlsFiles | None = None) -> Iterator[Client]:
    """A client of the scheduler at an address; InputError where none answers, or refuses it.

    Parameters
    ----------
    tls : what Dask's configuration tells, where they are not given.
    """
    with _quiet():
        security = Security() if tls is None else _security(address, tls)
        try:
            _knock(address)
        except (OSError, ValueError) as error:
            found = f"{address}, where nobody answers ({type(error).__name__})"
            allowed = "the address of a Dask scheduler that runs, as tcp://HOST:8786"
            raise InputError(WHERE, "", found, allowed) from error
        try:
            # In a thread: a notebook has a loop of its own in this one.
            with ThreadPoolExecutor(1) as pool:
                pool.submit(asyncio.run, _greet(address, security)).result()
            client = Client(address, security=security, timeout=ANSWER_S, set_as_default=False)
        # Those that are no OSError: one of both wants TLS, and the other has none.
        except (OSError, TypeError, RuntimeError) as error:
            found = f"{address}, which refuses this client ({type(error).__name__})"
            allowed = f"a Dask scheduler at tcp://HOST:8786, or tls://HOST:8786 with {TLS} for it"
            raise InputError(WHERE, "", found, allowed) from error
        with client:
            yield client


def _knock(address: str) -> None:
    """OSError or ValueError where nobody listens, which a client finds out only after long
    tries."""
    scheme, place = parse_address(address)
    get_backend(scheme)
    with socket.create_connection(parse_host_port(place), timeout=ANSWER_S):
        pass


async def _greet(address: str, security: Security) -> None:
    """Come and go; a client that is refused leaves threads behind."""
    arguments = security.get_connection_args("client")
    comm = await connect(address, timeout=ANSWER_S, **arguments)
    await comm.close()


def _security(address: str, tls: TlsFiles) -> Security:
    """What a client shows to a scheduler; InputError where the files are not what they should."""
    if not address.startswith("tls://"):
        found = f"files with {WHERE} {address}"
        raise InputError(TLS, "", found, f"{WHERE} tls://HOST:8786, where the scheduler has TLS")
    ca, cert, key = (str(file) for file in tls)
    for name, file in (("CA", ca), ("CERT", cert), ("KEY", key)):
        if not Path(file).is_file():
            raise InputError(TLS, name, file, "a file in PEM format")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(ca)
    except OSError as error:
        raise InputError(TLS, "CA", ca, "a file of certificates in PEM format") from error
    try:
        # Without a password OpenSSL would ask for the one of an encrypted key.
        context.load_cert_chain(cert, key, password="-")
    except OSError as error:
        allowed = "files of a certificate and of its key, not encrypted, in PEM format"
        raise InputError(TLS, "CERT and KEY", f"{cert} and {key}", allowed) from error
    files = {"tls_ca_file": ca, "tls_client_cert": cert, "tls_client_key": key}
    return Security(require_encryption=True, **files)


@contextmanager
def own_cluster(workers: int) -> Iterator[Client]:
    """A client of so many workers on this machine, one of which times replays; the program that
    started the campaign is hidden meanwhile, for a worker may have to be started again at any
    time."""
    stack = ExitStack()
    try:
        # Half a cluster cannot be closed.
        with signals_wait():
            client = stack.enter_context(_own_cluster(workers))
        yield client
    finally:
        with signals_wait():
            stack.close()


@contextmanager
def _own_cluster(workers: int) -> Iterator[Client]:
    with (
        _quiet(),
        without_main(),
        temporary_folder(Path(tempfile.gettempdir())) as folder,
        dask.config.set({**_OWN, "temporary-directory": str(folder)}),
        ExitStack() as stack,
    ):
        # Whoever reaches a scheduler or a worker runs Python as this user: other users of this
        # machine reach its loopback too, but have no certificate.
        security = Security.temporary()
        closed = {"host": LOOPBACK, "protocol": "tls://", "security": security}
        plain = {
            **closed,
            "worker_class": OwnWorker,
            "nthreads": 1,
            "memory_limit": 0,
            "dashboard": False,
            "silence_logs": logging.CRITICAL,
        }
        spec = {
            i: {"cls": Nanny, "options": {**plain, "resources": {EXCLUSIVE: 1} if i == 0 else {}}}
            for i in range(workers)
        }
        scheduler = {"cls": OwnScheduler, "options": {**closed, "dashboard": False}}
        with terminal_signals_blocked():
            cluster = SpecCluster(spec, scheduler, security=security, silence_logs=logging.CRITICAL)
            stack.enter_context(cluster)
            client = stack.enter_context(Client(cluster, set_as_default=False))
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

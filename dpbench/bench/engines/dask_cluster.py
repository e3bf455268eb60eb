"""A Dask cluster: reached by the address of its scheduler, or made of processes of this machine."""

import asyncio
import logging
import socket
import ssl
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import dask
from cryptography import x509  # noqa: F401 # Dask makes certificates with it and looks late
from distributed import Client, Nanny, Scheduler, SpecCluster, Worker, get_worker
from distributed.comm import connect
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.comm.registry import get_backend
from distributed.security import Security

from dpbench.bench.engines.engine import TlsFiles
from dpbench.bench.engines.on_worker import WorkerInfo, describe_worker, interrupt_tasks
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.workers.child import hide_main_module
from dpbench.bench.workers.interrupts import block_terminal_signals, delay_signals
from dpbench.errors import InputError
from dpbench.temporary_folders import make_temporary_folder_for_block

EXCLUSIVE = "exclusive"
"""The resource of which a machine's workers offer one together, if replays may be timed there."""
ANSWER_S = 5.0
"""Longest time that a scheduler may take to answer [s]."""
RETURN_S = 30.0
"""Longest time that a campaign waits for a scheduler that went away [s]."""
WHERE, TLS = "`scheduler`", "`tls`"
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
"""Address that all processes of a cluster of this machine listen at."""


class _WithoutHttp:
    """A Dask node without HTTP pages, which have no TLS and no option to turn them off."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """Start no HTTP server, in place of Dask's method that would start one."""


class OwnScheduler(_WithoutHttp, Scheduler):  # type: ignore[misc] # Dask is untyped here
    """The scheduler of a Dask cluster started on this machine."""


class OwnWorker(_WithoutHttp, Worker):  # type: ignore[misc] # Dask is untyped here
    """A worker of a Dask cluster started on this machine."""

    async def close(self, *args: Any, **kwargs: Any) -> Any:
        """Interrupt the running task, then close the worker; Dask would wait for the task."""
        interrupt_tasks()
        return await super().close(*args, **kwargs)


@contextmanager
def connect_client(address: str, tls: TlsFiles | None = None) -> Iterator[Client]:
    """Yield a client connected to a Dask scheduler; InputError where none answers or it refuses."""
    with _silence_dask():
        security = Security() if tls is None else _build_security(address, tls)
        try:
            scheme, place = parse_address(address)
            get_backend(scheme)
            with socket.create_connection(parse_host_port(place), timeout=ANSWER_S):
                pass
        except (OSError, ValueError) as error:
            found = f"{address}, where no scheduler answers ({type(error).__name__})"
            allowed = "the address of a running Dask scheduler, such as tcp://HOST:8786"
            raise InputError(WHERE, "", found, allowed) from error
        try:
            # In a thread: a notebook has a loop of its own in this one.
            with ThreadPoolExecutor(1) as pool:
                pool.submit(asyncio.run, _test_connection(address, security)).result()
            client = Client(address, security=security, timeout=RETURN_S, set_as_default=False)
        # Those that are no OSError: one of both wants TLS, and the other has none.
        except (OSError, TypeError, RuntimeError) as error:
            found = f"{address}, which refuses this client ({type(error).__name__})"
            allowed = f"a Dask scheduler at tcp://HOST:8786, or at tls://HOST:8786 with {TLS}"
            raise InputError(WHERE, "", found, allowed) from error
        with client:
            yield client


async def _test_connection(address: str, security: Security) -> None:
    """Test that a Dask scheduler accepts a connection, and close it; OSError if refused."""
    arguments = security.get_connection_args("client")
    comm = await connect(address, timeout=ANSWER_S, **arguments)
    await comm.close()


def _build_security(address: str, tls: TlsFiles) -> Security:
    """Return a Dask client's TLS set-up; InputError for wrong certificate or key files."""
    if not address.startswith("tls://"):
        found = f"files with {WHERE} {address}"
        raise InputError(TLS, "", found, f"{WHERE} tls://HOST:8786, if the scheduler uses TLS")
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
        allowed = "files of a certificate and of its unencrypted key, in PEM format"
        raise InputError(TLS, "CERT and KEY", f"{cert} and {key}", allowed) from error
    files = {"tls_ca_file": ca, "tls_client_cert": cert, "tls_client_key": key}
    return Security(require_encryption=True, **files)


@contextmanager
def start_own_cluster(workers: int) -> Iterator[Client]:
    """Start a Dask cluster of `workers` processes, one of them for timing; yield its client."""
    stack = ExitStack()
    try:
        # Half a cluster cannot be closed.
        with delay_signals():
            client = stack.enter_context(_open_own_cluster(workers))
        yield client
    finally:
        with delay_signals():
            stack.close()


@contextmanager
def _open_own_cluster(workers: int) -> Iterator[Client]:
    """Start scheduler and workers of a Dask cluster on this machine; yield its client."""
    with (
        _silence_dask(),
        hide_main_module(),
        make_temporary_folder_for_block(Path(tempfile.gettempdir())) as folder,
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
        with block_terminal_signals():
            cluster = SpecCluster(spec, scheduler, security=security, silence_logs=logging.CRITICAL)
            stack.enter_context(cluster)
            client = stack.enter_context(Client(cluster, set_as_default=False))
        yield client


class StepEvents(Silent):
    """Receiver of progress on a Dask worker that sends what is at work to a campaign's client."""

    def __init__(self, topic: str) -> None:
        self.topic = topic

    def advance(self, *report: object, **_: object) -> None:
        """Send the name of the latest work; what is finished the client knows by itself."""
        get_worker().log_event(self.topic, str(report[-1]))


class Cluster:
    """The workers of a Dask cluster that can take a campaign's runs, as they come and go.

    InputError for a worker that cannot run cells as they are here.

    Attributes
    ----------
    slots : tasks at a time; concurrency : the most of them on one machine so far.
    exclusive : whether a worker offered `EXCLUSIVE` when the campaign began.
    machine : that of the one that times replays; kinds : number of kinds of machines.
    """

    def __init__(self, client: Client, *, is_own: bool = False) -> None:
        self.client, self.is_own = client, is_own
        self._infos: dict[str, WorkerInfo] = {}
        self._refused: set[str] = set()
        self.concurrency, self.addresses = 1, frozenset[str]()
        client.wait_for_workers(1)
        for error in self._read_current_workers():
            raise error
        workers = {address: self._workers[address] for address in self._infos}
        exclusive = [a for a, w in workers.items() if w["resources"].get(EXCLUSIVE, 0) >= 1]
        offers: Counter[str] = Counter()
        for worker in workers.values():
            offers[worker["host"]] += worker["resources"].get(EXCLUSIVE, 0)
        if many := [host for host, times in offers.items() if times > 1]:
            found = f"the resource {EXCLUSIVE!r} {offers[many[0]]:g} times on machine {many[0]}"
            raise InputError(WHERE, "", found, f"{EXCLUSIVE}=1 on one worker of each machine")
        self.exclusive = bool(exclusive)
        self.machine = self._infos[(exclusive or [*workers])[0]].machine
        self.kinds = len({info.machine["id"] for info in self._infos.values()})

    def update_workers(self) -> list[str]:
        """Update the list of workers, if the scheduler answers; return remarks on refused ones."""
        try:
            return [
                f"a worker is given no cells: {error}" for error in self._read_current_workers()
            ]
        except OSError:
            return []

    def wait_for_reconnection(self) -> bool:
        """Wait until a lost Dask scheduler is back with a worker; return False if it stays away."""
        deadline = time.monotonic() + RETURN_S
        while time.monotonic() < deadline and self.client.status != "closed":
            with suppress(OSError):
                if self.client.status == "running" and self.client.scheduler_info()["workers"]:
                    return True
            time.sleep(0.1)
        return False

    def _read_current_workers(self) -> list[InputError]:
        """Read the current workers from the scheduler; return an error for each refused one."""
        if self.client.status != "running":
            return []
        workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        refused = []
        new = [a for a in workers if a not in self._infos and a not in self._refused]
        answers = self.client.run(describe_worker, workers=new, on_error="return") if new else {}
        infos = {address: info for address, info in self._infos.items() if address in workers}
        for address, answer in answers.items():
            if isinstance(answer, OSError):
                continue  # it went, or does not answer yet
            try:
                infos[address] = _parse_worker_info(address, answer)
            except InputError as error:
                refused.append(error)
                self._refused.add(address)
        if infos:
            self._infos, self._workers, self.addresses = infos, workers, frozenset(infos)
            on_host: Counter[str] = Counter()
            for address in infos:
                on_host[workers[address]["host"]] += int(workers[address]["nthreads"])
            self.slots = max(1, sum(on_host.values()))
            self.concurrency = max(self.concurrency, *on_host.values())
        return refused


def _parse_worker_info(address: str, answer: object) -> WorkerInfo:
    """Return a Dask worker's checked description of itself; InputError if it cannot take runs."""
    if not isinstance(answer, WorkerInfo):
        found = f"worker {address} without dpbench {HARNESS_VERSION} ({answer!r})"
        raise InputError(
            WHERE, "", found, "workers with the same Python environment as this dpbench"
        )
    if answer.harness_version != HARNESS_VERSION:
        found = f"worker {address} with dpbench {answer.harness_version}"
        raise InputError(WHERE, "", found, f"dpbench {HARNESS_VERSION}, as here")
    if not answer.may_start:
        found = f"worker {address}, a daemon, which cannot start processes"
        allowed = "workers started with DASK_DISTRIBUTED__WORKER__DAEMON=False"
        raise InputError(WHERE, "", found, allowed)
    return answer


@contextmanager
def _silence_dask() -> Iterator[None]:
    """Silence Dask's log messages in the block, as campaigns report lost workers themselves."""
    loggers = [logging.getLogger("tornado.application"), logging.getLogger("distributed")]
    quiet: list[logging.Logger | logging.Handler] = [loggers[0], *loggers[1].handlers]
    levels = [one.level for one in quiet]
    try:
        for one in quiet:
            one.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for one, level in zip(quiet, levels, strict=True):
            one.setLevel(level)

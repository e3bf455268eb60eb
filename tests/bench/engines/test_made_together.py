"""Sources that are needed next are made in one task, and apart when their worker died."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results
from dpbench.bench.engines.on_worker import make_files
from tests.bench.deterministic import run_suite, suite_toml

WHY = "engine dask needs the extra `cluster`"
distributed = pytest.importorskip("distributed", reason=WHY)
dask_engine = pytest.importorskip("dpbench.bench.engines.dask_engine", reason=WHY)

STUDY = suite_toml(
    study=[
        {
            **{"base": "weather", "steps": 3, "settings": ["default", "high"]},
            "replicates": {"key": "environment.seed", "count": 8},
        }
    ]
)


class Done:
    def __init__(self, key: str, task: Callable[[], object]) -> None:
        self.key, self.status = key, "finished"
        try:
            self._value = task()
        except distributed.KilledWorker as error:
            self.status, self._value = "error", error

    def result(self) -> object:
        if isinstance(self._value, Exception):
            raise self._value
        return self._value

    def add_done_callback(self, call: Callable[[Done], None]) -> None:
        call(self)


class Client:
    """Runs tasks as they are submitted; workers die of whatever makes several sources."""

    status = "running"

    def __init__(self) -> None:
        self.together: list[int] = []

    def wait_for_workers(self, count: int) -> None:
        """They are there."""

    def subscribe_topic(self, topic: str, handler: Callable[..., None]) -> None:
        """No worker sends an event."""

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": {"tcp://a:0": {"host": "a", "nthreads": 1, "resources": {}}}}

    def run(self, function: Callable[[], object], workers: list[str], on_error: str) -> Any:
        return {address: function() for address in workers}

    def submit(self, function: Callable[..., object], *args: Any, key: str, **how: Any) -> Done:
        told = {name: how[name] for name in ("isolated", "alone", "concurrency") if name in how}

        def task() -> object:
            if function is make_files:
                self.together.append(len(args[2]))
                if len(args[2]) > 1:
                    raise distributed.KilledWorker(key, None, 0)
            return function(*(_known(arg) for arg in args), **told)

        return Done(key, task)


def _known(arg: object) -> object:
    """An argument of a task, with what the tasks before it returned."""
    if isinstance(arg, dict):
        return {name: _known(value) for name, value in arg.items()}
    return arg.result() if isinstance(arg, Done) else arg


@pytest.mark.slow
def test_failed_sources_are_made_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client()

    @contextmanager
    def cluster(workers: int) -> Iterator[Client]:
        yield client

    monkeypatch.setattr(dask_engine, "start_own_cluster", cluster)
    out = run_suite(tmp_path, STUDY, engine="dask", jobs=1)
    assert set(load_results(out).runs["outcome"]) == {"finished"}
    several, apart = client.together[0], client.together[1:]
    assert several > 1 and 1 in apart

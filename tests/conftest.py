"""The workers of the tests, and seeded synthetic records for a report without a campaign."""

import gc
import json
import os
import tempfile
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pandas as pd
import pytest

from dpbench import open_workspace, run_closed_loop
from dpbench.analysis.records.records import Records
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import (
    SCHEMA_VERSION,
    convert_to_run_columns,
    convert_to_step_columns,
)
from dpbench.errors import SolverUnavailableError
from dpbench.report.report import Report
from dpbench.scenario.scenario import Scenario, load_scenario
from tests.result_folder import StepsInMemory, write_results

# No test asserts how long something takes: beside others an example may be drawn slowly.
hypothesis.settings.register_profile(
    "dpbench", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("dpbench")
# What `make test-fast` draws: a quarter of the examples.
hypothesis.settings.register_profile("quick", hypothesis.settings(), max_examples=25)

MACHINE: dict[str, Any] = {
    "id": "0123456789ab",
    "cpu_model": "Synthetic CPU",
    "cores": 2,
    "memory_GiB": 8,
    "kernel": "Linux 6.1",
    "python": "CPython 3.11",
    "governor": "not visible",
    "blas": ["openblas 0.3 Synthetic"],
    "affinity": [0, 1],
    "clock_read_ns": 40.0,
    "timer_resolution_ns": 1,
    "versions": {"numpy": "2.0", "dpbench": "0.1.0"},
}
SUITE: dict[str, Any] = {
    "name": "synthetic",
    "title": "Synthetic: records made by a test",
    "rounds": 5,
    "warmup_steps": 50,
    "cell_limit_s": 5.0,
    "requirements": {"error_move": 1e-2, "failed_steps": 0, "p99_ms": 3.0, "deadline_ms": 300.0},
    "harness_version": "0.1.0",
    "started_utc": "2026-01-01T00:00:00+00:00",
    "wall_s": 300.0,
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--without-extras`: a test that opens a solver of an extra is skipped, not failed."""
    parser.addoption("--without-extras", action="store_true")


@contextmanager
def _extras_may_be_absent(item: pytest.Item) -> Iterator[None]:
    try:
        yield
    except SolverUnavailableError as absent:
        if item.config.getoption("--without-extras"):
            pytest.skip(str(absent))  # only where --without-extras left the solver out on purpose
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    """A fixture that opens a solver of an extra."""
    with _extras_may_be_absent(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """A test that does."""
    with _extras_may_be_absent(item):
        return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whatever looks at a synthetic campaign with its report is slow: each worker makes both."""
    for item in items:
        if {"campaign", "sent"} & {*getattr(item, "fixturenames", ())}:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """The thousands of tests are there to the end: no collection of garbage walks through them."""
    gc.freeze()


def pytest_sessionfinish() -> None:
    """At the end all of it goes, and what libraries look for then too."""
    gc.unfreeze()


def pytest_configure(config: pytest.Config) -> None:
    """Compile before the workers of pytest-xdist start, and give each of those its own core and
    its own folder for what processes of a machine share.

    Two that compile at once would write one cache; two whose campaigns pin their processes would
    meet on one core.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker:
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})
        # Who times replays waits for whoever else runs cells on the machine, known by this folder.
        place = Path(tempfile.gettempdir()) / f"dpbench-tests-{os.getuid()}-{worker}"
        place.mkdir(exist_ok=True)
        tempfile.tempdir = os.environ["TMPDIR"] = str(place)
    elif config.getoption("numprocesses", None):
        run_closed_loop(load_scenario("paper").truncate(3), open_workspace("paper_active_set"))


_load_scenario = cache(load_scenario)


class MadeRecords:
    """Builds the records of a campaign that never ran, cell by cell."""

    def __init__(self) -> None:
        self._runs: list[dict[str, Any]] = []
        self._steps: list[pd.DataFrame] = []
        self._scenarios: dict[str, Scenario] = {}
        self._rng = np.random.default_rng(7)
        self.suite = dict(SUITE)

    def scenario(self, name: str) -> Scenario:
        """A scenario of the problem files."""
        if name not in self._scenarios:
            self._scenarios[name] = _load_scenario(name)
        return self._scenarios[name]

    def _row(
        self, mode: str, solver: str, scenario: str, columns: dict[str, Any]
    ) -> dict[str, Any]:
        row = {
            "run_id": f"run{len(self._runs):04d}",
            "mode": mode,
            "solver": solver,
            "solver_version": "1.0",
            "build": "",
            "generic_build": False,
            "scenario": scenario,
            "sequence": "",
            "study": "",
            "route": "qpsolvers",
            "policy": "fresh",
            "settings": "default",
            "options": "",
            "formulation": "condensed_box",
            "n": 30,
            "form": "dense",
            "units": "scaled",
            "outcome": "finished",
            "outcome_detail": "",
            "machine_id": MACHINE["id"],
            "seed": 0,
            "sample_s": self.scenario(scenario).sample_s,
            "steps_planned": 0,
            "steps_done": 0,
            "schema": SCHEMA_VERSION,
            "cell": json.dumps({"scenario": self.scenario(scenario).files}),
            "claimed_share": 1.0,
            "claimed_not_true": 0,
            "true_not_claimed": 0,
            "uncertified": 0,
            "optimum_bound_max": 1e-13,
        } | columns
        self._runs.append(row)
        return row

    def refused(self, solver: str, reason: str, mode: str = "closed_loop", **columns: Any) -> None:
        """A cell that did not run."""
        asked = {"outcome": "refused", "outcome_detail": reason, "steps_planned": 1000}
        sequence = {"sequence": "paper"} if mode == "replay" else {}
        self._row(mode, solver, "paper", asked | sequence | columns)

    def loop(
        self,
        solver: str,
        scenario: str = "paper",
        *,
        steps: int = 120,
        done: int | None = None,
        error: float = 1e-9,
        failed: int = 0,
        tail_m: float = 0.04,
        **columns: Any,
    ) -> None:
        """A closed loop whose largest error_move and count of failed steps are given."""
        done = steps if done is None else done
        figures: dict[str, Any] = {
            "steps_planned": steps,
            "steps_done": done,
            "error_move_p50": min(error, 1.0) / 10,
            "error_move_max": error,
            "error_plan_max": error,
            "failed_steps": failed,
            "true_share": 1.0 if error <= 1e-2 else 0.5,
            "raw_p50_ns": self._rng.uniform(1e4, 1e5),
            "raw_max_ns": self._rng.uniform(1e5, 1e6),
            "limit_violations": 0,
            "fallbacks": failed,
            "clipped": 0,
            "r_rms_m": 0.3,
            "r_95_m": 0.9,
            "r_max_m": 1.77,
            "r_tail_max_m": tail_m,
            "heading_max_deg": 0.4,
            "settle_s": 10.0,
            "settle_0p1m_s": 49.0,
            "overshoot_n": 0.5,
            "overshoot_e": 0.94,
            "share_1m": 0.95,
            "total_variation": 12.0,
            "closed_loop_cost": 100.0,
            "at_rate_surge": 0.0,
            "at_rate_sway": 0.13,
            "at_rate_yaw": 0.0,
            "dev_position_max_m": min(error, 1.0) / 3,
            "exact_steps": steps,
            "station_radius_m": 5.0,
            "exact_offset_max_m": 1.77,
            "exact_offset_max_s": 0.3,
            "exact_offset_end_m": 0.04,
            "exact_heading_max_deg": 0.85,
            "exact_heading_end_deg": 0.01,
            "exact_active_share": 0.14,
        }
        row = self._row("closed_loop", solver, scenario, figures | columns)
        if done:
            self._steps.append(self._loop_steps(row, done, error, tail_m))

    def sea(
        self, solver: str, point: int, replicate: int, x: Mapping[str, float], **columns: Any
    ) -> None:
        """A loop of the study `seas`, at a point with these values of its keys; `columns` and what
        else `loop` takes."""
        self.suite.setdefault("study", [{"base": "paper", "name": "seas", "radius_m": 1.0}])
        of_study = {"name": "seas", "point": point, "replicate": replicate, "x": dict(x)}
        cell = {"scenario": self.scenario("paper").files, "study": of_study}
        named = {"study": "seas", "study_point": point, "replicate": replicate}
        self.loop(solver, steps=40, cell=json.dumps(cell), **named, **columns)

    def _loop_steps(
        self, row: dict[str, Any], done: int, error: float, tail_m: float
    ) -> pd.DataFrame:
        scenario = self.scenario(row["scenario"])
        k = np.arange(done)
        t = k * scenario.sample_s
        swing = np.exp(-t / 15) * np.cos(t / 6)
        force = 3e5 * np.exp(-t / 15)[:, None] * np.sin(t / 6)[:, None] * [0.5, 1.0, 20.0]
        most = scenario.force_step_max
        change = np.clip(np.diff(force, axis=0, prepend=0.0), -most, most)
        moves = np.minimum(error, 1.0) * self._rng.uniform(0.05, 0.5, done)
        moves[-1] = error
        frame = pd.DataFrame(
            {
                "run_id": row["run_id"],
                "k": k,
                "t_s": t,
                "total_ns": self._rng.integers(20_000, 40_000, done),
                "counts": True,
                "claimed": True,
                "true": moves <= 1e-2,
                "error_move": moves,
                "n_m": 1.2 * swing + tail_m * np.sin(t / 9.5),
                "e_m": 1.3 * swing,
                "psi_rad": 0.005 * np.sin(t / 9.5),
            }
        )
        for i, axis in enumerate(("x_N", "y_N", "n_Nm")):
            frame[f"tau_{axis}"] = force[:, i]
            frame[f"dtau_{axis}"] = change[:, i]
        return convert_to_step_columns(frame)

    def replay(
        self,
        solver: str,
        sequence: str = "paper",
        *,
        steps: int = 1000,
        rounds: int = 3,
        median_us: float = 20.0,
        spread: float = 0.2,
        error: float = 1e-9,
        failed: int = 0,
        stopped: bool = False,
        wrong: Sequence[int] = (),
        lost: Sequence[int] = (),
        done: int | None = None,
        slow: Mapping[int, float] | None = None,
        setup: bool = False,
        iterations: int = 5,
        **columns: Any,
    ) -> None:
        """A replay with lognormal step times of a given median and spread.

        Steps of `wrong` have an answer that is not true, those of `lost` none at
        all, by the iteration limit, those of
        `slow` take so many times as long, and with `setup` each step holds a set-up. Only `done`
        steps are recorded; all by default.
        """
        figures: dict[str, Any] = {
            "sequence": sequence,
            "steps_planned": steps,
            "steps_done": steps if done is None else done,
            "rounds": rounds,
            "disturbed_rounds": 0,
            "counting_disturbed": 0,
            "turns": "made",
            "error_move_max": error,
            "failed_steps": failed,
            "true_share": 1.0 if error <= 1e-2 else 0.5,
            "setup_once_ns": 5e4,
            "matrix_updates": 0,
            "raw_p50_ns": median_us * 1e3,
            "raw_max_ns": self._rng.uniform(1e5, 1e6),
        }
        scenario = sequence.partition("[")[0].partition(" ")[0]
        row = self._row("replay", solver, scenario, figures | columns)
        if row["outcome"] != "finished":
            return
        if stopped:
            row["outcome"] = "timed_out"
        algo = 1e3 * median_us * np.exp(spread * self._rng.standard_normal(steps))
        for k, factor in (slow or {}).items():
            algo[k] *= factor
        # Round 1 is the fastest on every step, so that the minimum is known.
        slower = [
            np.ones(steps) if r == 1 else 1.0 + self._rng.uniform(0.01, 0.3, steps)
            for r in range(rounds + 1)
        ]
        frame = self._rounds(row["run_id"], (algo * np.array(slower))[:, :done])
        frame["true"] = (error <= 1e-2) & ~frame["k"].isin(wrong)
        frame["iterations"] = iterations + frame["k"] % 4
        frame["error_move"], frame["fallback"] = error, frame["k"].isin(lost)
        frame["status"] = np.where(frame["fallback"], "MAX_ITERATIONS", "")
        if setup:
            frame["setup_ns"], frame["update_ns"] = frame["update_ns"], pd.NA
        self._steps.append(convert_to_step_columns(frame))

    def _rounds(self, run_id: str, total: np.ndarray) -> pd.DataFrame:
        """The warm-up round and those that count, with their times (rounds, steps) [ns]."""
        r, k = (index.ravel() for index in np.indices(total.shape))
        ns = total.ravel()
        return pd.DataFrame(
            {
                "run_id": run_id,
                "repeat": r,
                "warmup": r == 0,
                "counts": r > 0,
                "k": k,
                "t_s": 0.3 * k,
                "total_ns": np.round(ns).astype(np.int64),
                "update_ns": np.round(0.2 * ns).astype(np.int64),
                "solve_ns": np.round(0.7 * ns).astype(np.int64),
                "read_ns": np.round(0.1 * ns).astype(np.int64),
            }
        )

    def results(self) -> Results:
        """The records so far."""
        steps = self._steps or [
            convert_to_step_columns(pd.DataFrame({"run_id": pd.Series([], dtype="str")}))
        ]
        runs = pd.DataFrame(self._runs or {"run_id": pd.Series([], dtype="str")})
        frame = pd.concat(steps, ignore_index=True)
        return Results(convert_to_run_columns(runs), StepsInMemory(frame), MACHINE, self.suite)

    def view(self) -> Records:
        """The view of the records so far."""
        return Records(self.results())

    def ending(self) -> dict[str, str]:
        """The last lines of a run that left these records, by the subject of each."""
        report = Report.from_results(self.results())
        return dict(report.summary_rows())

    def write(self, folder: Path) -> Path:
        """Write a result folder."""
        write_results(folder, self.results())
        return folder


@pytest.fixture
def records() -> MadeRecords:
    """An empty campaign."""
    return MadeRecords()


@pytest.fixture(scope="session")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder with the shapes of the standard suite in small."""
    return standard(MadeRecords(), scale=0.2).write(tmp_path_factory.mktemp("results") / "standard")


def standard(records: MadeRecords, scale: float = 1.0) -> MadeRecords:
    """Fill `records` like the standard suite: good, inexact, failing, slow and absent solvers."""
    configurations = {
        "daqp": (1e-13, 18.0),
        "quadprog": (1e-12, 22.0),
        "paper_active_set": (1e-12, 24.0),
        "piqp": (1e-6, 90.0),
        "clarabel": (1e-5, 240.0),
        "osqp": (0.4, 500.0),
        "scs": (0.1, 700.0),
        "ecos": (np.inf, 300.0),
        "highs": (1e-4, 900.0),
    }
    for scenario, steps in (
        ("paper", 1000),
        ("paper_tight", 1000),
        ("calm", 1000),
        ("rough", 2000),
    ):
        for solver, (error, _) in configurations.items():
            n = steps if scenario == "paper" else round(steps * scale)
            late = solver == "highs" and scenario == "rough"
            records.loop(
                solver,
                scenario,
                steps=n,
                done=n // 3 if late else n,
                error=error,
                failed=4 if np.isinf(error) else 0,
                outcome="timed_out" if late else "finished",
                outcome_detail="stopped after 5 s" if late else "",
                route="native" if solver == "paper_active_set" else "qpsolvers",
            )
        records.loop(
            "unconstrained_clipped",
            scenario,
            steps=round(steps * scale),
            error=1.0,
            tail_m=9.0 if scenario == "paper_tight" else 0.04,
            formulation="none",
            route="native",
            claimed_share=np.nan,
            settle_0p1m_s=np.inf if scenario == "paper_tight" else 64.0,
            overshoot_e=1.13,
            heading_max_deg=0.3,
        )
    for scenario in ("paper", "rough"):
        for units, settings in (("scaled", "high"), ("si", "default"), ("si", "high")):
            for solver, (error, _) in configurations.items():
                worse = 1e4 if units == "si" and settings == "default" and error > 1e-12 else 1.0
                tight = 1e-6 if settings == "high" else 1.0
                n = round(200 * scale)
                records.loop(
                    solver,
                    scenario,
                    steps=n,
                    error=error * worse * tight,
                    units=units,
                    settings=settings,
                    route="native" if solver == "paper_active_set" else "qpsolvers",
                )
    for sequence, steps in (("paper", 1000), ("rough[900:1400]", 500)):
        for policy in ("fresh", "warm"):
            for settings in ("default", "high"):
                for solver, (error, median) in configurations.items():
                    if policy == "warm" and solver == "ecos":
                        records.refused(
                            solver, "it takes no start", "replay", policy=policy, settings=settings
                        )
                        continue
                    high = settings == "high"
                    records.replay(
                        solver,
                        sequence,
                        steps=steps,
                        median_us=median * (1.4 if high else 1.0),
                        error=error * (1e-6 if high else 1.0),
                        settings=settings,
                        policy=policy,
                        route="native" if solver == "paper_active_set" else "qpsolvers",
                    )
        _native(records, sequence, steps)
    reason = "qpax is not installed: install the extra jax"
    records.refused("qpax", reason, steps_planned=round(1000 * scale))
    return records


def _native(records: Records, sequence: str, steps: int) -> None:
    """Native ways: one solver that gains at each step, one whose warm start breaks and costs."""
    gaining = {"fresh": 12.0, "reuse": 6.0, "warm": 5.0}
    for policy, median in gaining.items():
        records.replay(
            "daqp", sequence, steps=steps, median_us=median, route="native", policy=policy
        )
    breaking = {"fresh": 600.0, "reuse": 300.0, "warm": 400.0}
    for policy, median in breaking.items():
        records.replay(
            "highs",
            sequence,
            steps=steps,
            median_us=median,
            route="native",
            policy=policy,
            setup=policy == "fresh",
            wrong=(3, 5) if policy == "warm" else (),
        )
    asked = {"route": "native", "policy": "warm", "sequence": sequence}
    records.refused(
        "piqp", "policy warm: PIQP has no interface for a starting point", "replay", **asked
    )
    records.replay("piqp", sequence, steps=steps, median_us=60.0, route="native", policy="reuse")
    records.replay("qoco", sequence, steps=steps, median_us=70.0, route="native", policy="reuse")

"""Forecast of the time that `dpbench tune-solver` takes, without running anything."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.bench.engines.open_engine import count_slots
from dpbench.bench.estimate import (
    COMPILE_S,
    STATED_RATES,
    describe_what_is_not_forecast,
    estimate_run_seconds,
    find_finished_cells,
    format_duration,
)
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.workers.child import has_compiled_kernels
from dpbench.errors import ResultsError
from dpbench.solvers.contract import Options
from dpbench.tuning.campaigns import group_runs_by_settings, plan_settings, score_settings
from dpbench.tuning.request import SearchRequest, make_request
from dpbench.tuning.search import Score, SettingsSearch, split_into_batches


@dataclass(frozen=True)
class SearchForecast:
    """Expected time of a search [s], with `compile_s` for kernels; how many batches are finished.

    measured : whether the time is by finished batches of this search, else by stated rates.
    """

    request: SearchRequest
    finished: int
    time_s: float
    compile_s: float
    measured: bool
    remarks: Sequence[str]

    @property
    def lines(self) -> list[str]:
        """Lines of text on the expected time of a settings search, for `--dry-run`."""
        request = self.request
        batches = len(split_into_batches(request.trials))
        done = f", {self.finished} of them finished" if self.finished else ""
        training, test = (
            ", ".join(problem.name for problem in problems)
            for problems in (request.training, request.test)
        )
        names = ", ".join([*request.presets, *request.name_settings({})])
        compiled = f", with {format_duration(self.compile_s)} to compile kernels, once"
        rates = "finished batches" if self.measured else STATED_RATES.origin.partition(";")[0]
        return [
            f"{request.trials} settings of {request.solver.name} in batches on {training}: "
            f"{batches} batches{done}",
            f"then {names} on these and {test}",
            f"about {format_duration(self.time_s)} on this machine"
            f"{compiled if self.compile_s else ''}, by {rates}",
            *self.remarks,
            *request.searched,
            *request.remarks,
        ]


class _NotFinishedError(Exception):
    """End of the part of a search whose batches are finished."""


def estimate_tuning(solver: str, **asked: Any) -> SearchForecast:
    """Return the expected time of `tune_solver` with the same arguments; errors as there."""
    request = make_request(solver, **asked)
    search, finished_s, wall_s = _repeat_finished_batches(request)
    sizes = split_into_batches(request.trials)
    left = sizes[len(finished_s) :]
    of_size = {size: _estimate_batch_seconds(request, size) for size in set(left)}
    seconds = [of_size[size] for size in left]
    is_final_done = not left and _is_final_finished(request, search)
    if not is_final_done:
        seconds.append(_estimate_final_seconds(request))
    factor = sum(wall_s) / sum(finished_s) if finished_s else 1.0
    compile_s = 0.0 if has_compiled_kernels() or is_final_done else COMPILE_S
    return SearchForecast(
        request,
        len(finished_s),
        factor * sum(seconds) + compile_s,
        compile_s,
        bool(finished_s),
        describe_what_is_not_forecast(1) if seconds else (),
    )


def _repeat_finished_batches(
    request: SearchRequest,
) -> tuple[SettingsSearch, list[float], list[float]]:
    """Repeat a settings search as far as its batches are finished; return it and their times.

    Returns it, and for each such batch the forecast time and the time it took [s].
    """
    numbers, finished_s, wall_s = count(1), list[float](), list[float]()

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        folder = request.folder / f"batch-{next(numbers):02d}"
        cells = plan_settings(request.solver, request.training, settings)
        if len(find_finished_cells(cells, folder)) < len(cells):
            raise _NotFinishedError
        try:
            results = load_results(folder)
        except ResultsError as error:
            # Its runs are in parts yet, without a table.
            raise _NotFinishedError from error
        runs = group_runs_by_settings(Records(results).all_runs, request.training)
        finished_s.append(estimate_run_seconds(cells, count_slots(None), STATED_RATES))
        wall_s.append(results.suite.get("wall_s", finished_s[-1]))
        return score_settings(settings, runs, request.solver.requirements)

    search = SettingsSearch(request.space, evaluate, request.seed)
    with suppress(_NotFinishedError):
        search.run(request.trials, request.start)
    return search, finished_s, wall_s


def _estimate_batch_seconds(request: SearchRequest, size: int) -> float:
    """Return the expected time of a batch of so many settings by stated rates [s]."""
    shares = (np.arange(size) + 0.5) / size
    settings = [request.space.options_at(np.full(len(request.space.ranges), s)) for s in shares]
    cells = plan_settings(request.solver, request.training, settings)
    return estimate_run_seconds(cells, count_slots(None), STATED_RATES)


def _estimate_final_seconds(request: SearchRequest) -> float:
    """Return the expected time of the measurement on all sequences by stated rates [s]."""
    middle = request.space.options_at(np.full(len(request.space.ranges), 0.5))
    return estimate_run_seconds(
        plan_settings(
            request.solver,
            [*request.training, *request.test],
            list(request.name_settings(middle).values()),
            request.presets,
        ),
        count_slots(None),
        STATED_RATES,
    )


def _is_final_finished(request: SearchRequest, search: SettingsSearch) -> bool:
    """Return whether a search's best settings are measured, or need not be: none is accurate."""
    if not search.best.score.is_right:
        return True
    named = list(request.name_settings(search.best.options).values())
    problems = [*request.training, *request.test]
    cells = plan_settings(request.solver, problems, named, request.presets)
    return len(find_finished_cells(cells, request.folder / "final")) == len(cells)

"""Counts of a suite's table `[embedded]`: what solvers cost as C on emulated cores.

Each solver, core and part of a reference loop is counted in a process of its own and stored
in the folder of cells, so that a finished count is not repeated. A solver that cannot be counted
is noted with the reason, and the campaign goes on.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pandas as pd

from dpbench.bench.engines.dispatcher import Dispatcher
from dpbench.bench.plan.suite import EmbeddedTable
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.result_folder import UncountedSolver
from dpbench.bench.run.exact_loop import rebuild_sequence, solve_loop_exactly
from dpbench.bench.workers.worker import disable_gc_and_warnings, pin_to_core, write_outcome
from dpbench.embedded.recipe import find_recipes, select_recipes
from dpbench.embedded.table import (
    EMBEDDED_FILE,
    StepCounts,
    read_counted_steps_of_file,
    tabulate_counted_steps,
    write_counted_steps_atomically,
)
from dpbench.embedded.toolchain import find_target_by_name, installed_compiler, require_extra
from dpbench.errors import DpbenchError, InputError, ResultsError, format_allowed_names
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.scenario import build_or_reuse_scenario, load_scenario

LIMIT_S = 600.0
"""Longest time of a count; OSQP's 200 steps of `paper` take some 20 s."""
WORK = 5_000
"""A count in steps of a solver, for the progress bar."""


@dataclass(frozen=True, eq=False)
class PlannedCount:
    """A solver's C to count on one core, along steps of a scenario's reference loop."""

    solver: str
    target: str
    scenario: str
    files: ScenarioDocuments
    first: int
    steps: int
    single: bool

    @property
    def sequence(self) -> str:
        """Name of the QPs in the tables, such as paper[0:200]."""
        return f"{self.scenario}[{self.first}:{self.first + self.steps}]"

    @property
    def text(self) -> str:
        """JSON text of all fields, by which the count is stored and ordered from a process."""
        return json.dumps(asdict(self), sort_keys=True, ensure_ascii=False)

    def count_instructions(self) -> StepCounts:
        """Return the instructions counted in a solver's C along a reference loop's QPs."""
        # The emulator takes a while to load, and every campaign imports this module.
        from dpbench.embedded.count import count_instructions_along_sequence

        last = self.first + self.steps
        scenario = build_or_reuse_scenario(self.files)
        exact = solve_loop_exactly(scenario.truncate(last))
        exact.require_certificates(self.scenario)
        sequence = rebuild_sequence(scenario, exact, first=self.first, count=self.steps)
        return count_instructions_along_sequence(
            find_recipes()[self.solver],
            replace(sequence, name=self.sequence),
            find_target_by_name(self.target),
            single=self.single,
            optima=exact.optima[self.first : last],
        )


def pair_sequences_with_cores(
    table: EmbeddedTable, beside: Path | None = None
) -> list[PlannedCount]:
    """Return a planned count for each sequence, core and solver of a suite; InputError if bad."""
    known = list(find_recipes())
    for name in table.solvers:
        if name not in known:
            allowed = f"a solver with a build recipe: {format_allowed_names(name, known)}"
            raise InputError("suite", "embedded.solvers", repr(name), allowed)
    return [
        PlannedCount(solver, target, *part, single=table.precision == "float")
        for part in (
            _parse_scenario_and_steps(text, beside) for text in dict.fromkeys(table.sequences)
        )
        for target in dict.fromkeys(table.targets)
        for solver in (recipe.solver for recipe in select_recipes(table.solvers))
    ]


def _parse_scenario_and_steps(
    text: str, beside: Path | None
) -> tuple[str, ScenarioDocuments, int, int]:
    """Return name and files of a scenario, first step and number of steps."""
    name, *numbers = text.rsplit(":", 2)
    if len(numbers) != 2 or not all(number.isdecimal() for number in numbers):
        allowed = "SCENARIO:FIRST:STEPS, such as paper:0:200"
        raise InputError("suite", "embedded.sequences", repr(text), allowed)
    scenario, (first, steps) = load_scenario(name, beside=beside), map(int, numbers)
    if not 1 <= steps <= scenario.steps - first:
        allowed = f"STEPS of 1 or more, within steps 0 to {scenario.steps - 1} of {scenario.name}"
        raise InputError("suite", "embedded.sequences", repr(text), allowed)
    return scenario.name, scenario.files, first, steps


def run_count_in_process(text: str, folder: Path, name: str, core: int, path: Path) -> None:
    """Count a solver's C as a process's main function; write its steps to `path`, and outcome."""
    pin_to_core(core)
    disable_gc_and_warnings()
    try:
        require_extra()
        write_counted_steps_atomically(
            tabulate_counted_steps([PlannedCount(**json.loads(text)).count_instructions()]), path
        )
    except DpbenchError as error:
        write_outcome(folder / f"{name}.json", Outcome("invalid", str(error)))
        return
    write_outcome(folder / f"{name}.json", Outcome("finished", ""))


class EmbeddedCounts:
    """Counts of a suite's solvers on embedded cores; finished ones are stored in `cells`."""

    def __init__(self, counts: Sequence[PlannedCount], cells: Path, *, fresh: bool = False) -> None:
        made_by = json.dumps([HARNESS_VERSION, installed_compiler()])
        self._counts: dict[Path, PlannedCount] = {}
        for count in counts:
            key = hashlib.sha256((count.text + made_by).encode()).hexdigest()[:16]
            self._counts[cells / f"embedded-{key}.parquet"] = count
        self._reasons: dict[Path, str] = {}
        self._pending = [path for path in self._counts if fresh or _read_stored_count(path) is None]

    @property
    def work(self) -> int:
        """Remaining work of embedded counts, in equivalent solver steps, for the progress bar."""
        return WORK * len(self._pending)

    def is_written(self, out: Path) -> bool:
        """Return whether a result folder has the file of the finished counts, if there are any."""
        return len(self._pending) == len(self._counts) or (out / EMBEDDED_FILE).is_file()

    def run(self, dispatcher: Dispatcher, progress: Progress) -> None:
        """Make and store missing counts of solvers' C, each in a process; store why one failed."""
        for path in self._pending:
            path.unlink(missing_ok=True)
        texts = {path: self._counts[path].text for path in self._pending}
        for path, outcome in dispatcher.yield_made_files(
            run_count_in_process, texts, limit_s=LIMIT_S
        ):
            count = self._counts[path]
            # Reasons go to others with the results, which tell nothing of this machine's folders.
            self._reasons[path] = outcome.detail.replace(str(Path.home()), "~")
            progress.advance(WORK, f"count {count.solver} {count.target} {count.sequence}")

    def take_over_reasons(self, missing: Iterable[UncountedSolver]) -> None:
        """Store the given reasons why solvers were not counted on embedded cores."""
        known = {(one["solver"], one["target"], one["sequence"]): one["reason"] for one in missing}
        for path, count in self._counts.items():
            reason = known.get((count.solver, count.target, count.sequence))
            if reason is not None:
                self._reasons[path] = reason

    def write(self, out: Path) -> list[UncountedSolver]:
        """Write `embedded.parquet`, or remove it if nothing was counted; return what was not."""
        stored = {path: _read_stored_count(path) for path in self._counts}
        frames = [frame for frame in stored.values() if frame is not None]
        if frames:
            write_counted_steps_atomically(
                pd.concat(frames, ignore_index=True), out / EMBEDDED_FILE
            )
        else:
            (out / EMBEDDED_FILE).unlink(missing_ok=True)
        return [
            {
                "solver": count.solver,
                "target": count.target,
                "sequence": count.sequence,
                "reason": self._reasons.get(path) or "its count is damaged or missing",
            }
            for path, count in self._counts.items()
            if stored[path] is None
        ]


def _read_stored_count(path: Path) -> pd.DataFrame | None:
    """Return the stored steps of one count; None where they are missing or damaged."""
    try:
        return read_counted_steps_of_file(path) if path.is_file() else None
    except ResultsError:
        return None

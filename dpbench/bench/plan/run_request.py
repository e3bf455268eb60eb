"""What a person asks for, a suite or a part of it, and the plan that this means."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.choices import with_choices
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import SuiteFile, load_suite, naming, sequence_suite
from dpbench.bench.sequences.recording import read_sequence
from dpbench.errors import InputError
from dpbench.scenario.problem_files import sequence_path
from dpbench.solvers.table import load_solver_module


@dataclass(frozen=True, eq=False)
class Plan:
    """All cells of what was asked for.

    Parameters
    ----------
    path : the file of the suite; document : what is left of it.
    part : whether it is less than the whole suite.
    """

    name: str
    path: Path
    document: SuiteFile
    cells: list[PlannedCell]
    part: bool

    @cached_property
    def digest(self) -> str:
        """Of all cells: another plan has another one."""
        texts = sorted(planned.cell.to_json() for planned in self.cells)
        return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class RunRequest:
    """What is asked for; each as in `run_campaign`."""

    suite: str | None = None
    sequence: str | None = None
    solvers: Sequence[str] | None = None
    scenarios: Sequence[str] | None = None
    settings: Sequence[str] | None = None
    steps: int | None = None
    solver_module: str | None = None

    def plan(self) -> Plan:
        """The cells that are meant; InputError for whatever cannot be run."""
        if self.solver_module is not None:
            load_solver_module(self.solver_module)
        name, path, document = self._suite()
        chosen = {"scenarios": self.scenarios, "settings": self.settings}
        document = with_choices(document, steps=self.steps, **chosen)
        with naming(path, chosen=bool(self.settings)):
            cells = plan(
                document, solvers=self.solvers, scenarios=self.scenarios, beside=path.parent
            )
        part = bool(self.solvers or self.scenarios or self.settings or self.steps is not None)
        return Plan(name, path, document, cells, part)

    @property
    def _file(self) -> Path | None:
        """The file of the suite; None where it has a name, or is none."""
        named = self.suite is None or not self.suite.endswith(".toml")
        return None if named else Path(str(self.suite))

    @property
    def is_here(self) -> bool:
        """Whether the suite can be read on this machine."""
        return self._file is None or self._file.is_file()

    def from_anywhere(self) -> RunRequest:
        """The same, with the file of the suite as it is found from every folder."""
        file = self._file
        return self if file is None else replace(self, suite=str(file.resolve()))

    def _suite(self) -> tuple[str, Path, SuiteFile]:
        """Name, file and document of the suite, or of the one that replays a sequence."""
        if self.suite is not None and self.sequence is None:
            path, document = load_suite(self.suite)
            return path.stem, path, document
        if self.sequence is not None and self.suite is None:
            meta = read_sequence(sequence_path(self.sequence)).sequence.meta
            name = f"sequence-{Path(self.sequence).resolve().stem}"
            return name, Path("suite"), sequence_suite(self.sequence, meta)
        both = f"suite {self.suite} and --sequence {self.sequence}"
        found = "neither" if self.suite is None else both
        raise InputError("run", "", found, "a suite, or --sequence PATH")

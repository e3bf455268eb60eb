"""Sequences that ship with the package, by the rules of `problems/sequences/manifest.toml`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from dpbench.bench.progress import Progress, Silent
from dpbench.bench.run.exact_loop import Part
from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.bench.sequences.source import record_scenario
from dpbench.errors import InputError
from dpbench.scenario.problem_files import (
    SEQUENCES,
    FileModel,
    find_folder_of_shipped_problems,
    read_toml_as_model,
)
from dpbench.scenario.scenario import load_scenario
from dpbench.scenario.tables.key_types import Horizon

Positive = Annotated[int, Field(ge=1)]


class HorizonsTable(FileModel):
    """A pair of MPC horizons to record scenarios' QPs at, and which steps are kept."""

    prediction: Horizon
    control: Horizon
    every: Positive


class AllocationTable(FileModel):
    """A cascade whose thrust-allocation QPs are recorded, with length and which steps are kept."""

    scenario: str
    steps: Positive
    every: Positive


class LeftOutTable(FileModel):
    """Sequences of QPs that the manifest's rules give but the package leaves out, and why."""

    sequences: Annotated[list[str], Field(min_length=1)]
    reason: str


class ManifestFile(FileModel):
    """Content of `manifest.toml`: for which scenarios and horizons QPs are recorded and shipped."""

    title: str
    horizons: Annotated[list[HorizonsTable], Field(min_length=1)]
    steps: dict[str, Positive]
    allocations: list[AllocationTable] = []
    left_out: list[LeftOutTable] = []


@dataclass(frozen=True)
class RecordingRule:
    """Rule to record one shipped sequence of QPs: scenario, horizons, steps, which are kept."""

    scenario: str
    N_p: int
    N_c: int
    steps: int
    every: int
    part: Part = "controller"

    @property
    def name(self) -> str:
        """Name of the sequence, and of its file without `.npz`."""
        horizons = f"{self.N_p}-{self.N_c}" if self.part == "controller" else self.part
        return f"{self.scenario}-{horizons}"

    def record(self, steps: int | None = None) -> Recorded:
        """Return QPs recorded by this rule, or their beginning from the first `steps` samples."""
        scenario = load_scenario(self.scenario)
        # Second QPs are of one size, whatever the horizons.
        horizons = (self.N_p, self.N_c) if self.part == "controller" else None
        kept = {"steps": steps or self.steps, "every": self.every}
        return record_scenario(scenario, horizons=horizons, part=self.part, **kept)


def load_rules(path: Path | None = None) -> list[RecordingRule]:
    """Return the rules in a file by which shipped QPs are recorded; InputError if bad."""
    place = path or find_folder_of_shipped_problems() / SEQUENCES / "manifest.toml"
    manifest = read_toml_as_model(place, ManifestFile)
    rules = {rule.name: rule for rule in _expand_rules(manifest)}
    for table in manifest.left_out:
        for name in table.sequences:
            if rules.pop(name, None) is None:
                allowed = "SCENARIO-N_p-N_c with a scenario in [steps] and a pair in [[horizons]], "
                allowed += "each once"
                raise InputError(str(place), "left_out.sequences", repr(name), allowed)
    return list(rules.values())


def _expand_rules(manifest: ManifestFile) -> Iterator[RecordingRule]:
    """Yield one rule for each sequence that ships with the package, from the manifest."""
    for scenario, steps in manifest.steps.items():
        for table in manifest.horizons:
            yield RecordingRule(scenario, table.prediction, table.control, steps, table.every)
    for cascade in manifest.allocations:
        own = load_scenario(cascade.scenario).problem
        of_loop = own.N_p, own.N_c, cascade.steps, cascade.every
        yield RecordingRule(cascade.scenario, *of_loop, "allocation")


def record_shipped_sequences(
    out: str | Path, rules: Sequence[RecordingRule] | None = None, progress: Progress | None = None
) -> str:
    """Record the QPs shipped with the package again into a folder; return one line on them.

    The same machine and versions write the same bytes; others the same shapes and active sets, and
    values to rounding. CertificateError when a step cannot be certified.
    """
    wanted, folder, shown = list(rules or load_rules()), Path(out), progress or Silent()
    folder.mkdir(parents=True, exist_ok=True)
    shown.start(sum(rule.steps for rule in wanted))
    size = 0
    for rule in wanted:
        shown.advance(0, rule.name)
        recorded, path = rule.record(), folder / f"{rule.name}.npz"
        recorded.save(path)
        size += path.stat().st_size
        shown.advance(rule.steps, rule.name)
    return f"{folder}: {len(wanted)} sequences, {size / 1e6:.1f} MB"

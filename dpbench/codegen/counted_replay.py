"""Instructions that each step of a generated controller takes on embedded cores, by emulation.

A count is no time: there are no caches, no pipeline and no bus in it, and the worst step is the
worst of the recorded trajectory.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.codegen.controller_data import Trajectory
from dpbench.embedded.count import verify_calibration_counts
from dpbench.embedded.emulator import DATA, Core, Counts, Program, read_program_from_elf_file
from dpbench.embedded.toolchain import TARGETS, Target, compile_program
from dpbench.errors import SituationError
from dpbench.report.formats import format_count, join_with_and
from dpbench.temporary_folders import make_temporary_folder_for_block, process_temporary_folder

CORES = ("m7", "a53")
MOST_INSTRUCTIONS = 100_000_000
"""Most instructions of a replay on one core, some seconds: the start and each loss have a share."""
MOST_CHANGES = 3
"""Changes of limits, such as losses, whose steps have a share of their own."""
WARM_UP = 10
"""Steps solved before a counted part, not counted: they give it a warm start, and the controller
the last sample, which its prediction uses."""
FLAGS = ("-ffp-contract=off",)
"""As in the CMakeLists.txt of a controller: the replay compares with recorded commands."""


@dataclass(frozen=True)
class StepCost:
    """Cost of a controller's step on a core.

    core : its title; instructions : of each counted step; samples : these steps; recorded : steps
    of the trajectory; stack, code : bytes.
    """

    core: str
    instructions: Vector
    samples: tuple[int, ...]
    recorded: int
    stack: int
    code: int

    @property
    def steps(self) -> str:
        """Number of counted steps as text, with their ranges where some were not counted."""
        count = format_count(len(self.samples))
        if len(self.samples) == self.recorded:
            return count
        edges = [k for k in self.samples if k - 1 not in self.samples]
        ends = [k for k in self.samples if k + 1 not in self.samples]
        ranges = [
            f"{format_count(first)} to {format_count(last)}"
            for first, last in zip(edges, ends, strict=True)
        ]
        return f"{count} of {format_count(self.recorded)} ({join_with_and(ranges)})"

    @property
    def row(self) -> dict[str, str]:
        """Texts of the table in the controller's README."""
        numbers = {
            "median": np.median(self.instructions),
            "p99": np.percentile(self.instructions, 99),
            "worst": self.instructions.max(),
            "stack": self.stack,
            "code": self.code,
        }
        texts = {name: format_count(x) for name, x in numbers.items()}
        return {"core": self.core, "steps": self.steps} | texts

    @property
    def summary(self) -> str:
        """One line for the terminal."""
        row = self.row
        cost = f"a step takes {row['median']} instructions at the median and {row['worst']} at most"
        count, _, ranges = row["steps"].partition(" (")
        whole = format_count(self.recorded)
        counted = (
            f"counted on steps {ranges.removesuffix(')')} of {whole}"
            if ranges
            else f"{count} steps"
        )
        return f"On {self.core}, {cost} ({counted})"


def count_replay(
    files: Mapping[str, bytes], trajectory: Trajectory, step_max: Vector, tolerance: float
) -> list[StepCost]:
    """Replay a trajectory with a controller's sources on each core of `CORES`; return the costs.

    files : C sources and headers by name, with the shim `count_step.c`.
    step_max : (n_u,) maximum increment; tolerance : largest accepted difference from a recorded
    command, in such steps.

    Raises
    ------
    SituationError : the sources cannot be compiled, or other commands come out than recorded.
    """
    return [
        _replay(TARGETS[name], _compile(files, TARGETS[name]), trajectory, step_max, tolerance)
        for name in CORES
    ]


def _compile(files: Mapping[str, bytes], target: Target) -> Program:
    """Return the program of a controller and its shim for a core."""
    with make_temporary_folder_for_block(process_temporary_folder()) as folder:
        for name, text in files.items():
            (folder / name).write_bytes(text)
        sources = sorted(folder / name for name in files if name.endswith(".c"))
        return read_program_from_elf_file(
            compile_program(sources, target, written=folder, defines=FLAGS)
        )


def _replay(
    target: Target, program: Program, trajectory: Trajectory, step_max: Vector, tolerance: float
) -> StepCost:
    """Step the controller along the trajectory on an emulated core and count its steps alone."""
    verify_calibration_counts(target)
    core = Core(program, target)
    core.call_function_and_count("embedded_set_up", DATA)
    starts = [0, *trajectory.changes[:MOST_CHANGES]]
    counted: dict[int, Counts] = {}
    k, most, left = 0, 0.0, float(MOST_INSTRUCTIONS)
    for part, (first, end) in enumerate(zip(starts, [*starts[1:], None], strict=True)):
        if k < first - WARM_UP:
            k = first - WARM_UP
            _write_applied_command(core, trajectory.commands[k - 1])
        share = left / (len(starts) - part)
        while share >= 0.0 and k < (len(trajectory.commands) if end is None else end):
            counts, command = _step(core, trajectory, k)
            if k >= first:
                counted[k] = counts
                differs = np.abs((command - trajectory.commands[k]) / step_max)
                most = max(most, float(differs.max()))
                share -= counts.instructions
                left -= counts.instructions
            k += 1
    if not most <= tolerance:
        fault = f"a command on {target.title} differs from the recorded one by {most:.1g}"
        limit = f"at most {tolerance:g} of the maximum increment"
        raise SituationError("codegen", f"{fault}; allowed: {limit}")
    instructions = np.array([counts.instructions for counts in counted.values()], dtype=float)
    stack = max(counts.stack for counts in counted.values())
    return StepCost(
        target.title,
        instructions,
        tuple(counted),
        len(trajectory.commands),
        stack,
        program.sizes["code"],
    )


def _step(core: Core, trajectory: Trajectory, k: int) -> tuple[Counts, Vector]:
    """Return the counts of one step of a trajectory, and the command that it gives."""
    core.write_memory(DATA, trajectory.inputs[k].tobytes())
    core.call_function_and_count("embedded_read", DATA)
    counts = core.call_function_and_count("embedded_step", DATA)[1]
    return counts, _write_applied_command(core, trajectory.commands[k])


def _write_applied_command(core: Core, recorded: Vector) -> Vector:
    """Make a recorded command the applied one; return the command of the last step."""
    core.write_memory(DATA, recorded.tobytes())
    core.call_function_and_count("embedded_write", DATA)
    return np.frombuffer(core.read_memory(DATA, recorded.nbytes))

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
from dpbench.embedded.emulator import DATA, Core, Program, read_program_from_elf_file
from dpbench.embedded.toolchain import TARGETS, Target, compile_program
from dpbench.errors import SituationError
from dpbench.temporary_folders import make_temporary_folder_for_block, process_temporary_folder

CORES = ("m7", "a53")
MOST_INSTRUCTIONS = 100_000_000
"""Most instructions of a replay on one core, some seconds: no step is counted after them."""
FLAGS = ("-ffp-contract=off",)
"""As in the CMakeLists.txt of a controller: the replay compares with recorded commands."""


@dataclass(frozen=True)
class StepCost:
    """Cost of a controller's step on a core.

    core : its title; instructions : of each counted step; stack, code : bytes.
    """

    core: str
    instructions: Vector
    stack: int
    code: int

    @property
    def row(self) -> dict[str, str]:
        """Texts of the table in the controller's README."""
        numbers = {
            "median": np.median(self.instructions),
            "p99": np.percentile(self.instructions, 99),
            "worst": self.instructions.max(),
            "stack": self.stack,
            "code": self.code,
            "steps": len(self.instructions),
        }
        return {"core": self.core} | {name: f"{x:,.0f}" for name, x in numbers.items()}

    @property
    def summary(self) -> str:
        """One line for the terminal."""
        row = self.row
        steps = f"a step takes {row['median']} instructions in the median, {row['worst']} at most"
        return f"On {self.core} {steps}, of {row['steps']} steps"


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
    counted, most, left = [], 0.0, MOST_INSTRUCTIONS
    for inputs, recorded in zip(trajectory.inputs, trajectory.commands, strict=True):
        core.write_memory(DATA, inputs.tobytes())
        core.call_function_and_count("embedded_read", DATA)
        counted.append(core.call_function_and_count("embedded_step", DATA)[1])
        core.write_memory(DATA, recorded.tobytes())
        core.call_function_and_count("embedded_write", DATA)
        command = np.frombuffer(core.read_memory(DATA, recorded.nbytes))
        most = max(most, float(np.abs((command - recorded) / step_max).max()))
        left -= counted[-1].instructions
        if left < 0:
            break
    if not most <= tolerance:
        limit = f"{tolerance:g} of the maximum increment"
        raise SituationError(
            "codegen", f"on {target.title} a command differs by {most:.1g}; allowed: {limit}"
        )
    instructions = np.array([counts.instructions for counts in counted], dtype=float)
    stack = max(counts.stack for counts in counted)
    return StepCost(target.title, instructions, stack, program.sizes["code"])

"""Count what a solver's C executes at each step of a QP sequence, and have its answers judged.

A count compares solvers under one compiler and its flags. It is no time: there are no caches, no
pipeline and no bus in it, and the worst step is the worst of this sequence.

Other tools count the same, where they are installed. Unicorn's calls, and what it was given and
answered, are recorded and repeated with the same machine code: on x86 by Valgrind's callgrind, on
Arm by QEMU's user emulation, which logs every instruction.
"""

import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Floats, Ints, Matrix, Vector
from dpbench.embedded.emulator import (
    DATA,
    DATA_SIZE,
    PROGRAM,
    PROGRAM_SIZE,
    Core,
    Counts,
    EmulationError,
    Program,
    read_program_from_elf_file,
)
from dpbench.embedded.recipe import Recipe, Settings
from dpbench.embedded.table import COUNTED, StepCounts
from dpbench.embedded.toolchain import (
    RUNTIME,
    Target,
    cache_folder,
    compile_loader,
    compile_program,
)
from dpbench.errors import SituationError
from dpbench.qp.program import CONSTANT, QPSequence, QPStep
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_all_steps, measure_first_move_and_plan_errors_of_many
from dpbench.temporary_folders import process_temporary_folder

_ARRAYS = ("P", "q", "A", "l", "u", "lb", "ub", "z")
"""Pointers of `embedded_qp`, in their order."""
_Core = TypeVar("_Core", bound=Core)
_INTEGERS = struct.Struct("<8i")
THOUSAND = 1000
STACK_BYTES = 480  # As in `calibration.c`


class Mailbox:
    """The QP in the core's memory: the structure `embedded_qp` and its arrays."""

    def __init__(self, core: Core, sequence: QPSequence, target: Target, *, single: bool) -> None:
        n, m = sequence.base.n, sequence.base.m
        self._core, self._type = core, np.dtype("<f4" if single else "<f8")
        self._integers = [n, m, sequence.base.block, 0, 0, -1, -1, 0]
        sizes = dict(zip(_ARRAYS, (n * n, n, m * n, m, m, n, n, n), strict=True))
        word = "Q" if target.bits == 64 else "I"
        self._places, address = {}, DATA + 256
        for name, size in sizes.items():
            self._places[name] = address
            address += size * self._type.itemsize + 64 & ~63
        self._pointers = struct.pack(f"<{len(_ARRAYS)}{word}", *self._places.values())
        self._z_bytes = n * self._type.itemsize
        for name in _ARRAYS[:-1]:
            self.write_array_to_core(name, getattr(sequence.base, name))

    def write_array_to_core(self, name: str, values: Floats) -> None:
        """Write an array; in single precision what is beyond it becomes infinite."""
        with np.errstate(over="ignore"):
            self._core.write_memory(self._places[name], values.astype(self._type).tobytes())

    def write_step_to_core(self, step: QPStep) -> None:
        """Write a step's vectors and matrices, and the structure."""
        changed = [name for name in CONSTANT if getattr(step, name) is not None]
        for name in ("q", "l", "u", *changed):
            self.write_array_to_core(name, getattr(step, name))
        self._integers[3] = int(bool(changed))
        self.write_inputs_and_clear_answer()

    def write_inputs_and_clear_answer(self) -> None:
        """Write the program's input structure into the core's memory, and NaN over its answer."""
        self._core.write_memory(DATA, _INTEGERS.pack(*self._integers) + self._pointers)
        self.write_array_to_core("z", np.full(self._z_bytes // self._type.itemsize, np.nan))

    def read_status_iterations_and_answer(self) -> tuple[int, int, int, Vector]:
        """Return status, iterations, active rows and answer that the program left in memory."""
        numbers = _INTEGERS.unpack(self._core.read_memory(DATA, _INTEGERS.size))
        z = np.frombuffer(self._core.read_memory(self._places["z"], self._z_bytes), self._type)
        return numbers[4], numbers[5], numbers[6], z.astype(np.float64)


def count_instructions_along_sequence(
    recipe: Recipe,
    sequence: QPSequence,
    target: Target,
    *,
    single: bool = False,
    settings: Settings | None = None,
    optima: Sequence[Optimum] | None = None,
) -> StepCounts:
    """Count what a solver's C executes along a sequence; `optima` are certified if not given.

    Raises
    ------
    InputError : the solver's C cannot take these QPs, or a setting is none of its own.
    SituationError : its source cannot be fetched or compiled, or it refuses the first QP.
    EmulationError : the core cannot execute it, or the counters are wrong.
    """
    own = settings or {}
    core, mailbox = open_core_with_solver_set_up(
        recipe, sequence, target, single=single, settings=own, kind=Core
    )
    columns, answers = run_all_steps_and_count(core, mailbox, sequence)
    certified = certify_all_steps(sequence) if optima is None else optima
    errors = measure_first_move_and_plan_errors_of_many(
        answers, certified, sequence.base.block, sequence.base.moves
    )
    steps = dict(zip(COUNTED, columns, strict=True))
    sizes = {**core.code_and_data_bytes, "heap": core.count_heap_bytes()}
    names = recipe.solver, target.name, sequence.name
    return StepCounts(*names, single, recipe.with_settings(own), steps, answers, *errors, sizes)


def open_core_with_solver_set_up(
    recipe: Recipe,
    sequence: QPSequence,
    target: Target,
    *,
    single: bool,
    settings: Settings | None,
    kind: Callable[[Program, Target], _Core],
) -> tuple[_Core, Mailbox]:
    """Return a core on which the solver of a recipe is set up for a sequence, and its mailbox.

    Errors are those of `count_instructions_along_sequence`.
    """
    verify_calibration_counts(target)
    with tempfile.TemporaryDirectory(dir=process_temporary_folder()) as folder:
        path = recipe.compile(
            sequence, target, Path(folder), single=single, settings=settings or {}
        )
        core = kind(read_program_from_elf_file(path), target)
    mailbox = Mailbox(core, sequence, target, single=single)
    mailbox.write_inputs_and_clear_answer()
    refused, _ = core.call_function_and_count("embedded_set_up", DATA)
    if refused:
        raise SituationError(
            recipe.solver, f"its set-up for {sequence.name} fails with code {refused}"
        )
    return core, mailbox


def run_all_steps_and_count(
    core: Core, mailbox: Mailbox, sequence: QPSequence
) -> tuple[NDArray[np.int64], Matrix]:
    """Run all steps; return the columns (7, K) of `COUNTED` and the answers (K, n)."""
    columns = np.zeros((len(COUNTED), len(sequence)), dtype=np.int64)
    answers = np.empty((len(sequence), sequence.base.n))
    for k in range(len(sequence)):
        columns[:, k], answers[k] = _run_step_and_count(core, mailbox, sequence.step(k))
    return columns, answers


def _run_step_and_count(
    core: Core, mailbox: Mailbox, step: QPStep
) -> tuple[NDArray[np.int64], Vector]:
    """Run one step; return its column of `COUNTED` and its answer."""
    mailbox.write_step_to_core(step)
    _, counts = core.call_function_and_count("embedded_step", DATA)
    status, iterations, active, z = mailbox.read_status_iterations_and_answer()
    executed = counts.instructions, counts.loads, counts.stores, counts.stack
    return np.array([*executed, iterations, active, status]), z


@cache
def verify_calibration_counts(target: Target) -> None:
    """Run the calibration program of a core; EmulationError unless every count is as known."""
    core = Core(
        read_program_from_elf_file(compile_program([RUNTIME / "calibration.c"], target)), target
    )
    # A return of x86 loads the address, which the caller has put on the stack.
    popped = 0 if target.link else 1

    def expect(instructions: int, loads: int, stores: int, stack: int) -> Counts:
        memory = (loads + popped, stores) if target.counts_memory else (-1, -1)
        return Counts(instructions, *memory, stack or 8 * popped)

    known = {
        "embedded_set_up": expect(THOUSAND + 1, 0, 0, 0),
        "embedded_loads": expect(THOUSAND + 1, THOUSAND, 0, 0),
        "embedded_stores": expect(THOUSAND + 1, 0, THOUSAND, 0),
        "embedded_stack": expect(4, 0, 1, STACK_BYTES),
    }
    for name, expected in known.items():
        _, counts = core.call_function_and_count(name, DATA)
        if counts != expected:
            raise EmulationError(f"{target.title}: {name} counts {counts} instead of {expected}")


TOOLS = {"x86": "valgrind", "a53": "qemu-aarch64", "m7": "qemu-arm"}
"""Program that counts for each target; Debian has them in `valgrind` and `qemu-user`."""
SYSTEMS = {
    "x86": "x86_64-linux-musl",
    "a53": "aarch64-linux-musl",
    "m7": "arm-linux-musleabihf",
}
SKIPPED = 0.02
"""Largest share of instructions that Thumb code skips by a condition: QEMU counts these, Unicorn
does not."""
_WRITE, _CALL, _COMPARE = 1, 2, 3
_PC = re.compile(rb"\[[0-9a-f]+/([0-9a-f]+)/")


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """Counts of the same calls by two tools.

    Parameters
    ----------
    tool : name of the other one.
    instructions, others : (K,) of each step, by Unicorn and by that tool.
    differing_bytes : of status, iterations and answers.
    """

    tool: str
    instructions: Ints
    others: Ints
    differing_bytes: int

    @property
    def has_equal_answers_and_counts(self) -> bool:
        """Return whether all answers are equal, and all counts: on M7 to within `SKIPPED`."""
        allowed = SKIPPED * self.others if self.tool == TOOLS["m7"] else 0.0
        differences = np.abs(self.instructions - self.others)
        return not self.differing_bytes and bool((differences <= allowed).all())


class _RecordingCore(Core):
    """A core that keeps a trace of what it was given, what it ran and what it answered."""

    def __init__(self, program: Program, target: Target) -> None:
        super().__init__(program, target)
        self.trace = bytearray()
        for address, data in program.parts:
            self._append_event_to_trace(_WRITE, address, data)

    def _append_event_to_trace(self, kind: int, address: int, data: bytes) -> None:
        """Append an event, its address and its bytes to the recorded trace."""
        self.trace += struct.pack("<3Q", kind, address, len(data)) + data

    def call_function_and_count(self, name: str, argument: int) -> tuple[int, Counts]:
        """Call a function, and note that."""
        self.trace += struct.pack("<3Q", _CALL, self.find_address_of_function(name), argument)
        return super().call_function_and_count(name, argument)

    def write_memory(self, address: int, data: bytes) -> None:
        """Write bytes into the core's memory, and note them."""
        self._append_event_to_trace(_WRITE, address, data)
        super().write_memory(address, data)

    def read_memory(self, address: int, size: int) -> bytes:
        """Read bytes from the core's memory, and note them."""
        data = super().read_memory(address, size)
        self._append_event_to_trace(_COMPARE, address, data)
        return data


def compare_counts_with_second_tool(
    recipe: Recipe,
    sequence: QPSequence,
    target: Target,
    *,
    single: bool = False,
    settings: Settings | None = None,
) -> SecondOpinion:
    """Count the steps of a sequence by Unicorn and by the target's other tool.

    SituationError where that is not installed or fails; others are those of
    `count_instructions_along_sequence`.
    """
    tool = TOOLS.get(target.name)
    if tool is None or shutil.which(tool) is None:
        found = f"{tool} is not installed" if tool else "there is no other tool"
        raise SituationError(f"second opinion on {target.title}", found)
    core, mailbox = open_core_with_solver_set_up(
        recipe, sequence, target, single=single, settings=settings, kind=_RecordingCore
    )
    columns, _ = run_all_steps_and_count(core, mailbox, sequence)
    with tempfile.TemporaryDirectory(dir=process_temporary_folder()) as folder:
        trace = Path(folder, "trace")
        trace.write_bytes(core.trace)
        loader = _compile_linux_loader(target)
        if tool == "valgrind":
            others, differing = _count_steps_by_callgrind(loader, trace, Path(folder))
        else:
            others, differing = _count_steps_by_qemu(
                tool, loader, trace, core.find_address_of_function("embedded_step")
            )
    counted = columns[0]
    if len(others) != len(counted):
        only = "only " if len(others) < len(counted) else ""
        fault = f"it counted {only}{len(others)} of {len(counted)} steps"
        raise SituationError(
            f"second opinion by {tool}", f"{fault}; run again without --second-opinion"
        )
    return SecondOpinion(tool, counted, np.array(others, dtype=np.int64), differing)


def _compile_linux_loader(target: Target) -> Path:
    """Compile the loader for Linux on a target's processor, away from the program's addresses."""
    places = {
        "PROGRAM": PROGRAM,
        "PROGRAM_SIZE": PROGRAM_SIZE,
        "DATA": DATA,
        "DATA_SIZE": DATA_SIZE,
    }
    defines = [f"-D{name}={value:#x}" for name, value in places.items()]
    flags = ["-target", SYSTEMS[target.name], "-O2", "-static", "-Wl,--image-base=0x40000000"]
    out = cache_folder("programs") / f"loader-{target.name}"
    return compile_loader([RUNTIME / "loader.c"], [*flags, *defines], out)


def _count_steps_by_callgrind(loader: Path, trace: Path, folder: Path) -> tuple[list[int], int]:
    """Return each step's instructions by callgrind, and the number that the program prints."""
    options = ["--tool=callgrind", f"--callgrind-out-file={folder / 'counts'}", "--quiet"]
    with trace.open("rb") as stream:
        done = subprocess.run(
            ["valgrind", *options, str(loader)], check=False, stdin=stream, capture_output=True
        )
    if done.returncode:
        raise SituationError("second opinion by valgrind", done.stderr.decode()[:300])
    totals = []
    for number in range(1, len(list(folder.glob("counts.*"))) + 1):
        match = re.search(r"^totals: (\d+)", (folder / f"counts.{number}").read_text(), re.M)
        totals.append(int(match[1]) if match else 0)
    # A function of one instruction comes first, then the set-up.
    return [total - totals[0] + 1 for total in totals[2:]], int(done.stdout)


def _count_steps_by_qemu(tool: str, loader: Path, trace: Path, entry: int) -> tuple[list[int], int]:
    """Return each step's instructions by QEMU's log, and the number that the program prints."""
    shown = subprocess.run([tool, "-h"], check=False, capture_output=True, text=True).stdout
    single = "-one-insn-per-tb" if "one-insn-per-tb" in shown else "-singlestep"
    logged = f"{PROGRAM:#x}..{PROGRAM + PROGRAM_SIZE - 1:#x}"
    command = [tool, single, "-d", "exec,nochain", "-dfilter", logged, str(loader)]
    with (
        trace.open("rb") as stream,
        subprocess.Popen(
            command, stdin=stream, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as run,
    ):
        assert run.stderr is not None and run.stdout is not None
        counts = list(_yield_instructions_of_each_call(run.stderr, entry & ~1))
        answer = run.stdout.read()
    if run.returncode or not answer:
        raise SituationError(f"second opinion by {tool}", f"it exits with code {run.returncode}")
    return counts, int(answer)


def _yield_instructions_of_each_call(log: IO[bytes], entry: int) -> Iterator[int]:
    """Yield the instructions of each call of a function, from QEMU's log."""
    count = -1
    for line in log:
        match = _PC.search(line)
        if match is None:
            continue
        if int(match[1], 16) == entry:
            if count > 0:
                yield count
            count = 0
        if count >= 0:
            count += 1
    if count > 0:
        yield count

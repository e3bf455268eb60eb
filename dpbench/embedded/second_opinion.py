"""Instructions of a program counted by other tools, where these are installed.

Unicorn's calls, and what it was given and answered, are recorded and repeated with the same machine
code: on x86 by Valgrind's callgrind, on Arm by QEMU's user emulation, which logs every instruction.
"""

import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from dpbench.arrays import Ints
from dpbench.embedded.count import open_core_with_solver_set_up, run_all_steps_and_count
from dpbench.embedded.emulator import DATA, DATA_SIZE, PROGRAM, PROGRAM_SIZE, Core, Counts, Program
from dpbench.embedded.recipe import Recipe, Settings
from dpbench.embedded.toolchain import RUNTIME, Target, cache_folder, compile_loader
from dpbench.errors import SituationError
from dpbench.qp.program import QPSequence
from dpbench.temporary_folders import process_temporary_folder

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
        found = f"it counts {len(others)} steps of {len(counted)}"
        raise SituationError(f"second opinion by {tool}", found)
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
        raise SituationError(f"second opinion by {tool}", f"it ends with {run.returncode}")
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

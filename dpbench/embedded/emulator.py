"""Run a compiled program's functions on an emulated core and count what they execute.

Instructions, loads and stores are counted by functions that Numba compiles, as Unicorn calls them
for every instruction. They are there before the first run: what the emulator translated before is
not counted. The stack is painted before each call, and what is no longer paint after it was used.
"""

import ctypes
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
import numpy as np

from dpbench.embedded.toolchain import Target
from dpbench.errors import DpbenchError

SIZES = {".text": "code", ".rodata": "constants", ".data": "static", ".bss": "static"}
"""Kind of memory that each section of a program counts as."""
RETURN = 0x0001_0000  # Where a function returns to: nothing is executed there
PROGRAM, PROGRAM_SIZE = 0x0010_0000, 0x1000_0000  # Code, constants, static data, heap
DATA, DATA_SIZE = 0x2000_0000, 0x1000_0000  # Arrays of the harness
STACK, STACK_SIZE = 0x6000_0000, 0x0004_0000  # Growing down
STACK_TOP = STACK + STACK_SIZE
_PAGE = 0x1000
LONGEST_US = 60_000_000  # Of one call, which takes some 10 ns an instruction
_PAINT = bytes([0xA5]) * STACK_SIZE
_INSTRUCTIONS, _LOADS, _STORES = range(3)
_types: Any = numba.types
_cfunc: Any = numba.cfunc
_carray: Any = numba.carray  # type: ignore[attr-defined,unused-ignore] # not in all releases
_VOID, _POINTER = _types.void, _types.voidptr
_CODE = _VOID(_POINTER, _types.uint64, _types.uint32, _POINTER)
_MEMORY = _VOID(_POINTER, _types.int32, _types.uint64, _types.int32, _types.int64, _POINTER)


@dataclass(frozen=True)
class Program:
    """A program of a bare core.

    Parameters
    ----------
    parts : address and bytes of what is loaded.
    symbols : address of each name; of a Thumb function with its lowest bit set.
    sizes : bytes of code, constants and static data.
    """

    parts: list[tuple[int, bytes]]
    symbols: dict[str, int]
    sizes: dict[str, int]


def read_program_from_elf_file(path: Path) -> Program:
    """Read a compiled program from its ELF file: bytes to load, symbols and sizes."""
    elf_file: Any = import_module("elftools.elf.elffile").ELFFile
    with path.open("rb") as file:
        elf = elf_file(file)
        parts = [
            (segment["p_vaddr"], segment.data())
            for segment in elf.iter_segments()
            if segment["p_type"] == "PT_LOAD" and segment["p_filesz"]
        ]
        table = elf.get_section_by_name(".symtab")
        symbols = {symbol.name: symbol["st_value"] for symbol in table.iter_symbols()}
        sizes = dict.fromkeys(SIZES.values(), 0)
        for section in elf.iter_sections():
            if section.name in SIZES:
                sizes[SIZES[section.name]] += section["sh_size"]
    return Program(parts, symbols, sizes)


class EmulationError(DpbenchError):
    """A program that the emulated core cannot execute, with the emulator's message."""


@dataclass(frozen=True)
class Counts:
    """Counts of one call: instructions, loads and stores (−1: not counted), bytes of stack."""

    instructions: int
    loads: int
    stores: int
    stack: int


@_cfunc(_CODE, cache=True)
def _count_executed_instruction(engine, address, size, counts):  # type: ignore[no-untyped-def] # Numba types it by the signature above
    """Count one executed instruction in an array that Unicorn's hook hands on."""
    _carray(counts, 3, np.uint64)[_INSTRUCTIONS] += np.uint64(1)


@_cfunc(_MEMORY, cache=True)
def _count_memory_load(engine, kind, address, size, value, counts):  # type: ignore[no-untyped-def] # Numba types it by the signature above
    """Count one load from memory in an array that Unicorn's hook hands on."""
    _carray(counts, 3, np.uint64)[_LOADS] += np.uint64(1)


@_cfunc(_MEMORY, cache=True)
def _count_memory_store(engine, kind, address, size, value, counts):  # type: ignore[no-untyped-def] # Numba types it by the signature above
    """Count one store to memory in an array that Unicorn's hook hands on."""
    _carray(counts, 3, np.uint64)[_STORES] += np.uint64(1)


class Core:
    """An emulated core with a program in its memory."""

    def __init__(self, program: Program, target: Target) -> None:
        self._program, self._target = program, target
        self._unicorn: Any = import_module("unicorn")
        self._constants: Any = import_module(f"unicorn.{target.constants}")
        self._counts = np.zeros(3, dtype=np.uint64)
        self._core = self._unicorn.Uc(
            getattr(self._unicorn, target.arch), getattr(self._unicorn, target.mode)
        )
        self._core.ctl_set_cpu_model(getattr(self._constants, target.model))
        for address, size in (
            (RETURN, _PAGE),
            (PROGRAM, PROGRAM_SIZE),
            (DATA, DATA_SIZE),
            (STACK, STACK_SIZE),
        ):
            self._core.mem_map(address, size)
        for address, data in program.parts:
            self._core.mem_write(address, data)
        for name, value in target.enable_fpu:
            self._write_value_into_register(name, value)
        self._install_instruction_counters()

    def _look_up_register_number(self, name: str) -> int:
        """Return Unicorn's number of a register of the core, by its name."""
        number: int = getattr(self._constants, name)
        return number

    def _write_value_into_register(self, name: str, value: int) -> None:
        """Write a value into a register of the core, by its name."""
        self._core.reg_write(self._look_up_register_number(name), value)

    def _install_instruction_counters(self) -> None:
        """Have Unicorn call the compiled counters directly, and not through Python."""
        library: Any = import_module("unicorn.unicorn_py3.unicorn").uclib
        self._hooks = []
        counters = {"UC_HOOK_CODE": _count_executed_instruction}
        if self._target.counts_memory:
            counters |= {
                "UC_HOOK_MEM_READ": _count_memory_load,
                "UC_HOOK_MEM_WRITE": _count_memory_store,
            }
        for kind, counter in counters.items():
            hook = ctypes.c_size_t()
            error = library.uc_hook_add(
                self._core._uch,
                ctypes.byref(hook),
                getattr(self._unicorn, kind),
                ctypes.c_void_p(counter.address),
                ctypes.c_void_p(self._counts.ctypes.data),
                ctypes.c_uint64(1),
                ctypes.c_uint64(0),
            )
            if error:
                raise EmulationError(
                    f"{self._target.name}: Unicorn does not accept the counter ({error})"
                )
            self._hooks.append(hook)

    def call_function_and_count(self, name: str, argument: int) -> tuple[int, Counts]:
        """Call a function of one pointer on the core; return its result and its counts."""
        target, core = self._target, self._core
        stack, first, result = target.registers
        top = STACK_TOP
        if target.link:
            # A Thumb address has its lowest bit set.
            self._write_value_into_register(target.link, RETURN | (target.name == "m7"))
        else:
            top -= 8
            core.mem_write(top, RETURN.to_bytes(8, "little"))
        self._write_value_into_register(stack, top)
        self._write_value_into_register(first, argument)
        self._counts[:] = 0
        core.mem_write(STACK, _PAINT[: top - STACK])
        try:
            core.emu_start(self._program.symbols[name], RETURN, timeout=LONGEST_US)
        except self._unicorn.UcError as error:
            raise EmulationError(f"{target.name}: {name}: {error}") from None
        if core.query(self._unicorn.UC_QUERY_TIMEOUT):
            raise EmulationError(f"{target.name}: {name} does not end within {LONGEST_US / 1e6} s")
        instructions, loads, stores = self._counts.tolist()
        if not target.counts_memory:
            loads = stores = -1
        used = np.frombuffer(core.mem_read(STACK, STACK_SIZE), np.uint8) != _PAINT[0]
        depth = STACK_SIZE - int(used.argmax()) if used.any() else 0
        value = core.reg_read(self._look_up_register_number(result)) & 0xFFFF_FFFF
        signed = value - (1 << 32) if value >> 31 else value
        return signed, Counts(instructions, loads, stores, depth)

    @property
    def code_and_data_bytes(self) -> dict[str, int]:
        """Bytes of the program's code, constants and static data."""
        return self._program.sizes

    def find_address_of_function(self, name: str) -> int:
        """Return the address of a function."""
        return self._program.symbols[name]

    def write_memory(self, address: int, data: bytes) -> None:
        """Write bytes into the emulated core's memory."""
        self._core.mem_write(address, data)

    def read_memory(self, address: int, size: int) -> bytes:
        """Read bytes from the emulated core's memory."""
        return bytes(self._core.mem_read(address, size))

    def count_heap_bytes(self) -> int:
        """Return how many bytes of heap the program has taken so far."""
        symbols, word = self._program.symbols, self._target.bits // 8
        if "embedded_heap_end" not in symbols:
            return 0
        end = int.from_bytes(self.read_memory(symbols["embedded_heap_end"], word), "little")
        return end - symbols["heap_start"]

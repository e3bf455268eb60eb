"""A compiled program: what it puts where in memory, its functions and its sizes."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

SIZES = {".text": "code", ".rodata": "constants", ".data": "static", ".bss": "static"}
"""Kind of memory that each section of a program counts as."""


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

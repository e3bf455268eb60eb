"""Check an emulated core's counters against a program whose counts are known."""

from functools import cache

from dpbench.embedded.emulator import DATA, Core, Counts, EmulationError, read_program_from_elf_file
from dpbench.embedded.toolchain import RUNTIME, Target, compile_program

THOUSAND = 1000
STACK_BYTES = 480  # As in `calibration.c`


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
            raise EmulationError(f"{target.title}: {name} counts {counts}, and not {expected}")

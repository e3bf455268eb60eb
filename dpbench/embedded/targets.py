"""Embedded cores that programs are compiled for and emulated on."""

from dataclasses import dataclass, field

from dpbench.errors import UnknownNameError, list_allowed


@dataclass(frozen=True)
class Target:
    """A core: how zig compiles for it, and how Unicorn emulates it.

    Parameters
    ----------
    name, title : the word of the command line; the name in tables.
    triple, cpu : zig's target and processor.
    headers : folder of its C library's headers in ziglang.
    arch, mode, model : names of Unicorn's constants.
    registers : names of Unicorn's constants: stack pointer, first argument, result.
    bits : of a pointer.
    """

    name: str
    title: str
    triple: str
    cpu: str
    headers: str
    arch: str
    mode: str
    model: str
    registers: tuple[str, str, str]
    bits: int
    flags: tuple[str, ...] = field(default=())

    @property
    def compiler_flags(self) -> list[str]:
        """Flags of the compiler that choose this core."""
        return ["-target", self.triple, f"-mcpu={self.cpu}", *self.flags]


TARGETS = {
    target.name: target
    for target in (
        Target(
            name="m7",
            title="Cortex-M7",
            triple="thumb-freestanding-eabihf",
            # Without the suffix zig compiles for software floating point.
            cpu="cortex_m7+fp_armv8d16",
            headers="arm-linux-musl",
            arch="UC_ARCH_ARM",
            # Unicorn's own M7 cannot be given an FPU: its CPACR is not reachable.
            mode="UC_MODE_THUMB",
            model="UC_CPU_ARM_MAX",
            registers=("UC_ARM_REG_SP", "UC_ARM_REG_R0", "UC_ARM_REG_R0"),
            bits=32,
        ),
        Target(
            name="a53",
            title="Cortex-A53",
            triple="aarch64-freestanding-none",
            cpu="cortex_a53",
            headers="aarch64-linux-musl",
            arch="UC_ARCH_ARM64",
            mode="UC_MODE_ARM",
            model="UC_CPU_ARM64_A53",
            registers=("UC_ARM64_REG_SP", "UC_ARM64_REG_X0", "UC_ARM64_REG_X0"),
            bits=64,
        ),
        Target(
            name="riscv",
            title="RISC-V RV64GC",
            triple="riscv64-freestanding-none",
            cpu="generic_rv64+m+a+f+d+c",
            headers="riscv64-linux-musl",
            arch="UC_ARCH_RISCV",
            mode="UC_MODE_RISCV64",
            model="UC_CPU_RISCV64_ANY",
            registers=("UC_RISCV_REG_SP", "UC_RISCV_REG_A0", "UC_RISCV_REG_A0"),
            bits=64,
            # Code may lie anywhere in 32 bits.
            flags=("-mcmodel=medany",),
        ),
        Target(
            name="x86",
            title="x86-64-v2",
            triple="x86_64-freestanding-none",
            cpu="x86_64_v2",
            headers="x86_64-linux-musl",
            arch="UC_ARCH_X86",
            mode="UC_MODE_64",
            model="UC_CPU_X86_NEHALEM",
            registers=("UC_X86_REG_RSP", "UC_X86_REG_RDI", "UC_X86_REG_RAX"),
            bits=64,
        ),
    )
}
"""Every target by its name on the command line."""


def find_target(name: str) -> Target:
    """Return the target of a name; UnknownNameError for any other."""
    if name not in TARGETS:
        raise UnknownNameError("--target", "", repr(name), list_allowed(name, list(TARGETS)))
    return TARGETS[name]

"""Embedded cores that programs are compiled for and emulated on."""

from dataclasses import dataclass

from dpbench.errors import UnknownNameError, format_allowed_names


@dataclass(frozen=True)
class Target:
    """A core: how zig compiles for it, and how Unicorn emulates it.

    Parameters
    ----------
    name, title : the word of the command line; the name in tables.
    triple, cpu : zig's target and processor.
    headers : folder of its C library's headers in ziglang.
    arch, mode, model : names of Unicorn's constants.
    constants : Unicorn's module of the names of registers.
    registers : stack pointer, first argument, result.
    link : register of the return address; "" where that is on the stack.
    bits : of a pointer.
    enable_fpu : registers and what to write to them before floating point works.
    counts_memory : whether loads and stores can be counted without changing what the core does.
    """

    name: str
    title: str
    triple: str
    cpu: str
    headers: str
    arch: str
    mode: str
    model: str
    constants: str
    registers: tuple[str, str, str]
    link: str
    bits: int
    enable_fpu: tuple[tuple[str, int], ...]
    flags: tuple[str, ...] = ()
    counts_memory: bool = True

    @property
    def compiler_flags(self) -> list[str]:
        """Compiler flags that select this embedded core."""
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
            constants="arm_const",
            registers=("UC_ARM_REG_SP", "UC_ARM_REG_R0", "UC_ARM_REG_R0"),
            link="UC_ARM_REG_LR",
            bits=32,
            enable_fpu=(("UC_ARM_REG_C1_C0_2", 0xF << 20), ("UC_ARM_REG_FPEXC", 1 << 30)),
            # Hooks of memory in Unicorn 2.1 change the results of this core.
            counts_memory=False,
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
            constants="arm64_const",
            registers=("UC_ARM64_REG_SP", "UC_ARM64_REG_X0", "UC_ARM64_REG_X0"),
            link="UC_ARM64_REG_LR",
            bits=64,
            enable_fpu=(("UC_ARM64_REG_CPACR_EL1", 3 << 20),),
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
            constants="riscv_const",
            registers=("UC_RISCV_REG_SP", "UC_RISCV_REG_A0", "UC_RISCV_REG_A0"),
            link="UC_RISCV_REG_RA",
            bits=64,
            enable_fpu=(("UC_RISCV_REG_MSTATUS", 3 << 13),),
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
            constants="x86_const",
            registers=("UC_X86_REG_RSP", "UC_X86_REG_RDI", "UC_X86_REG_RAX"),
            link="",
            bits=64,
            enable_fpu=(("UC_X86_REG_CR4", 3 << 9),),
        ),
    )
}
"""Every target by its name on the command line."""


def find_target_by_name(name: str) -> Target:
    """Return the target of a name; UnknownNameError for any other."""
    if name not in TARGETS:
        raise UnknownNameError(
            "--target", "", repr(name), format_allowed_names(name, list(TARGETS))
        )
    return TARGETS[name]

"""Cross-compile C with `ziglang`: programs of embedded cores, and libraries of other systems.

A program is kept in the user's cache folder under a hash of compiler, flags and sources, so that
the same build is compiled once.
"""

import hashlib
import importlib.metadata
import importlib.util
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dpbench.errors import SituationError, UnknownNameError, format_allowed_names
from dpbench.temporary_folders import process_temporary_folder

FOLDER = Path(__file__).parent
RUNTIME = FOLDER / "runtime"
REMEDY = "run `pip install 'dpbench[embedded]'`"
FLAGS = (
    "-g0 -O2 -fomit-frame-pointer -fhosted -fno-math-errno -fno-sanitize=all "
    "-fno-exceptions -fno-unwind-tables -fno-asynchronous-unwind-tables -ffunction-sections "
    "-fdata-sections"
)
"""Compiler flags of every program: hosted, so that `sqrt` is an instruction."""
CPLUSPLUS = (
    "-fno-rtti -fno-threadsafe-statics -nostdinc++ -D_GNU_SOURCE -D_LIBCPP_ABI_VERSION=1 "
    "-D_LIBCPP_ABI_NAMESPACE=__1 -D_LIBCPP_DISABLE_VISIBILITY_ANNOTATIONS "
    "-D_LIBCPP_HARDENING_MODE=_LIBCPP_HARDENING_MODE_NONE "
    "-D_LIBCPP_ASSERTION_SEMANTIC_DEFAULT=_LIBCPP_ASSERTION_SEMANTIC_IGNORE "
    "-D_LIBCPP_HAS_MUSL_LIBC=1 -D_LIBCPP_HAS_THREADS=0 -D_LIBCPP_HAS_LOCALIZATION=1 "
    "-D_LIBCPP_HAS_WIDE_CHARACTERS=1 -D_LIBCPP_HAS_UNICODE=1 -D_LIBCPP_HAS_TERMINAL=0 "
    "-D_LIBCPP_HAS_MONOTONIC_CLOCK=1 -D_LIBCPP_HAS_RANDOM_DEVICE=0 -D_LIBCPP_HAS_FILESYSTEM=0 "
    "-D_LIBCPP_HAS_TIME_ZONE_DATABASE=0 -D_LIBCPP_HAS_VENDOR_AVAILABILITY_ANNOTATIONS=0"
)
"""Further flags of a program with C++: what zig's C++ library is configured by."""
SUFFIXES = {".c", ".h", ".cpp", ".hpp", ".ipp", ".tpp"}
LINK = "-nostdlib -Wl,--gc-sections -Wl,--entry=embedded_set_up"
"""Flags of the linker: without the compiler's own library, which takes a minute to build and is
hardly needed."""
EXTRAS = ("ziglang", "unicorn", "elftools")


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


def require_extra() -> None:
    """Raise SituationError if a package of the extra `embedded` is missing."""
    missing = [name for name in EXTRAS if importlib.util.find_spec(name) is None]
    if missing:
        names = " and ".join("pyelftools" if name == "elftools" else name for name in missing)
        verb = "is" if len(missing) == 1 else "are"
        raise SituationError("embedded", f"{names} {verb} not installed: {REMEDY}")


def has_extra() -> bool:
    """Return whether every package of the extra `embedded` is installed."""
    return all(importlib.util.find_spec(name) is not None for name in EXTRAS)


def compiler_version() -> str:
    """Return the version of ziglang; SituationError where it is not installed."""
    try:
        return importlib.metadata.version("ziglang")
    except importlib.metadata.PackageNotFoundError:
        raise SituationError("embedded", f"ziglang is not installed: {REMEDY}") from None


def installed_compiler() -> str:
    """Return the version of ziglang; "" where it is not installed."""
    return compiler_version() if importlib.util.find_spec("ziglang") else ""


def cache_folder(name: str) -> Path:
    """Return a folder for `name` in the user's cache, made if missing; else one of this process."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute()
    folder = home / "dpbench" / "embedded" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    folder = process_temporary_folder() / name
    folder.mkdir(exist_ok=True)
    return folder


def compile_library(sources: Iterable[Path], triple: str, out: Path) -> Path:
    """Compile C sources to a shared library of another system at `out`; return its path.

    `triple` is zig's name of the system, such as x86_64-linux-gnu, x86_64-windows-gnu or
    aarch64-macos. SituationError with the compiler's words if that fails.
    """
    position = [] if "windows" in triple else ["-fPIC"]
    flags = ("-std=c99", "-O2", "-ffp-contract=off", *position, "-shared", "-s")
    return _compile(["-target", triple, *flags], sources, out)


def compile_program(
    sources: Sequence[Path],
    target: Target,
    *,
    written: Path | None = None,
    include: Sequence[Path] = (),
    defines: Sequence[str] = (),
) -> Path:
    """Compile C or C++ sources to a program of a bare core; return the ELF file, kept in the cache.

    `written` is a folder of headers for this program alone. The compiler runs in it, so that its
    path is not in the command; a hash of its files is.

    SituationError with the compiler's words if that fails.
    """
    script = RUNTIME / "program.ld"
    everything = [*sources, RUNTIME / "runtime.c"]
    has_cplusplus = any(path.suffix == ".cpp" for path in sources)
    everything += [RUNTIME / "cplusplus.cpp"] if has_cplusplus else []
    language = CPLUSPLUS.split() if has_cplusplus else ["-std=c99"]
    words = [*target.compiler_flags, *language, *FLAGS.split(), *defines]
    own = [written] if written else []
    # For zig's own cache, a header of the same name in another working folder is the same header.
    words += [f"-DWRITTEN_{_hash([], _list_sources(folder))}" for folder in own]
    # A source may include another one.
    folders = {RUNTIME, *own, *include, *(path.parent for path in sources)}
    files = {*everything, *(file for folder in folders for file in _list_sources(folder))}
    key = _hash([compiler_version(), LINK, *words], [*files, script])
    out = cache_folder("programs") / f"{key}.elf"
    if not out.exists():
        headers = [f"-isystem{folder}" for folder in _header_folders(target)]
        # zig's own folder of headers, which must come after these, is one of -isystem.
        headers += _include_flags(_cplusplus_folders() if has_cplusplus else [])
        linker = [*LINK.split(), "-T", str(script)]
        searched = _include_flags([RUNTIME, *([Path()] if written else []), *include])
        _compile([*words, *headers, *searched, *linker], everything, out, cwd=written)
    return out


def compile_loader(sources: Sequence[Path], flags: Sequence[str], out: Path) -> Path:
    """Compile C sources to a program of Linux, kept at `out` with a hash; return its path."""
    key = _hash([compiler_version(), *flags], sources)
    path = out.with_name(f"{out.name}-{key}")
    return path if path.exists() else _compile(flags, sources, path)


def _include_flags(folders: Iterable[Path]) -> list[str]:
    """Return the compiler's flags for folders of headers."""
    return [f"-I{folder}" for folder in folders]


def _list_sources(folder: Path) -> list[Path]:
    """Return all files of C and C++ in a folder and below."""
    return [path for path in folder.rglob("*.*") if path.suffix in SUFFIXES]


def _find_zig_library() -> Path:
    """Return the folder of what ziglang brings for its targets."""
    found = importlib.util.find_spec("ziglang")
    assert found is not None and found.origin is not None
    return Path(found.origin).parent / "lib"


def _header_folders(target: Target) -> list[Path]:
    """Return the folders of the C library's headers that ziglang brings for a target."""
    library = _find_zig_library() / "libc" / "include"
    return [library / target.headers, library / "generic-musl"]


def _cplusplus_folders() -> list[Path]:
    """Return the folders of the C++ library's headers that ziglang brings."""
    return [_find_zig_library() / name / "include" for name in ("libcxx", "libcxxabi")]


def _hash(words: Sequence[str], files: Sequence[Path]) -> str:
    """Return a hash of words and of the contents of files."""
    digest = hashlib.sha256("\n".join(words).encode())
    for path in sorted(files):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:24]


def _compile(
    words: Sequence[str], sources: Iterable[Path], out: Path, *, cwd: Path | None = None
) -> Path:
    """Run the compiler into `out`, which is written whole or not at all."""
    compiler_version()
    partial = out.with_name(f".{os.getpid()}.{out.name}")
    named = (path.relative_to(cwd) if cwd and cwd in path.parents else path for path in sources)
    command = [sys.executable, "-m", "ziglang", "cc", *words, *map(str, named)]
    try:
        done = subprocess.run(
            [*command, "-o", str(partial)], check=False, capture_output=True, text=True, cwd=cwd
        )
        if done.returncode:
            shown = shlex.join(["cc", *words[:2]])
            first = [line for line in done.stderr.splitlines() if "error:" in line]
            words_of = " ".join((first or done.stderr.splitlines() or ["no message"])[:2])
            raise SituationError(f"{shown} {out.name}", f"the compilation failed: {words_of}")
        partial.replace(out)
    finally:
        # What the linker puts beside a library of Windows.
        for rest in out.parent.glob(f".{os.getpid()}.*"):
            rest.unlink(missing_ok=True)
    return out

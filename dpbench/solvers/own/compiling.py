"""Compile the C library of dpbench's own solvers; needs Python alone, as `hatch_build.py` runs it.

The compiler is `ziglang`, a build requirement; the environment variable DPBENCH_CC names another
one. Without ziglang the `cc` of the system serves.
"""

import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import zlib
from pathlib import Path

FOLDER = Path(__file__).parent
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# Neither the machine's own instructions nor contracted products: the same results everywhere.
FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-shared", "-fPIC")
# The oldest glibc that zig links against, and the processors of wheels with the tag manylinux.
GLIBC = (2, 17)
MANYLINUX_MACHINES = ("aarch64", "x86_64")
REMEDY = "run `pip install ziglang`, or name a C compiler with DPBENCH_CC, such as DPBENCH_CC=cc"


def make_library_file_name() -> str:
    """Return the library's file name, with a checksum of sources and flags."""
    checksum = zlib.crc32(" ".join(FLAGS).encode())
    for path in sorted(FOLDER.glob("*.[ch]")):
        checksum = zlib.crc32(path.read_bytes(), checksum)
    return f"_own_{checksum:08x}{SUFFIX}"


def has_zig_compiler() -> bool:
    """Return whether ziglang compiles: it is installed, and DPBENCH_CC names no other compiler."""
    return not os.environ.get("DPBENCH_CC") and importlib.util.find_spec("ziglang") is not None


def links_to_oldest_glibc() -> bool:
    """Return whether the library is linked against `GLIBC` instead of this machine's C library."""
    is_glibc = sys.platform == "linux" and platform.libc_ver()[0] == "glibc"
    return has_zig_compiler() and is_glibc and platform.machine() in MANYLINUX_MACHINES


def make_wheel_tag() -> str:
    """Return the tag of a wheel with the library, which ctypes loads in any Python 3 (PEP 600)."""
    if links_to_oldest_glibc():
        return f"py3-none-manylinux_{GLIBC[0]}_{GLIBC[1]}_{platform.machine()}"
    return f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"


def find_c_compiler_command() -> list[str]:
    """Return the command of a C compiler; RuntimeError if there is none."""
    named = os.environ.get("DPBENCH_CC", "")
    if named:
        return shlex.split(named)
    if has_zig_compiler():
        # Without a processor named, zig takes the one of this machine.
        command = [sys.executable, "-m", "ziglang", "cc", "-s", "-mcpu=baseline"]
        if links_to_oldest_glibc():
            command += ["-target", f"{platform.machine()}-linux-gnu.{GLIBC[0]}.{GLIBC[1]}"]
        return command
    if shutil.which("cc"):
        return ["cc"]
    raise RuntimeError(f"found no C compiler; {REMEDY}")


def compile_own_library_if_missing(folder: Path = FOLDER) -> Path:
    """Return the library's path in a folder, compiled if it is missing; RuntimeError if that fails.

    Libraries of other sources in that folder are removed.
    """
    target = folder / make_library_file_name()
    if target.exists():
        return target
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f"{target.name}.{os.getpid()}"
    # It includes the others.
    source = str(FOLDER / "hildreth.c")
    command = [*find_c_compiler_command(), *FLAGS, "-o", str(partial), source]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except FileNotFoundError:
        raise RuntimeError(f"found no C compiler {command[0]!r}; {REMEDY}") from None
    except (OSError, subprocess.CalledProcessError) as error:
        words = (getattr(error, "stderr", "") or str(error)).strip()
        raise RuntimeError(f"{shlex.join(command)}: {words}; {REMEDY}") from None
    for stale in folder.glob(f"_own_*{SUFFIX}"):
        stale.unlink(missing_ok=True)
    partial.replace(target)
    return target

"""The program that `mat.py` runs: MATLAB file on its input, numbers of one structure on its output.

It imports nothing of dpbench, and limits itself before it reads a byte.
"""

import io
import resource
import sys
from typing import Any

MEMORY_BYTES = 2**29  # Python with SciPy takes a quarter of it
TIME_S = 10  # Of a processor; a file of the largest size that is read takes a second


def write_mat_structure_to_stdout(name: str) -> int:
    """Read a MATLAB file on stdin, write a structure's numbers to stdout; return 1 on failure."""
    _lower_own_resource_limit(resource.RLIMIT_AS, MEMORY_BYTES)
    _lower_own_resource_limit(resource.RLIMIT_CPU, TIME_S)
    _lower_own_resource_limit(resource.RLIMIT_CORE, 0)
    import numpy as np
    import scipy.io

    try:
        with open(sys.stdin.fileno(), "rb", closefd=False) as file:
            content = scipy.io.loadmat(file, simplify_cells=True)  # type: ignore[arg-type] # the stubs know no files
    except Exception as error:  # of what is no such file SciPy may raise anything
        print(" ".join(str(error).split())[:200] or type(error).__name__, file=sys.stderr)
        return 1
    names = [key for key in content if not key.startswith("__")]
    arrays: dict[str, Any] = {"names": np.array(names, dtype="U63")}
    structure = content.get(name) if name else {key: content[key] for key in names}
    if isinstance(structure, dict):
        arrays |= {
            f"{name}.{key}" if name else key: value
            for key, value in _flatten_numeric_fields_by_dotted_name(structure).items()
        }
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    sys.stdout.buffer.write(packed.getvalue())
    return 0


def _lower_own_resource_limit(kind: int, most: int) -> None:
    """Lower a limit of this process's memory or time, unless it is lower already."""
    _, highest = resource.getrlimit(kind)
    most = most if highest == resource.RLIM_INFINITY else min(most, highest)
    resource.setrlimit(kind, (most, highest))


def _flatten_numeric_fields_by_dotted_name(structure: dict[str, Any]) -> dict[str, Any]:
    """Return a nested structure's arrays by dotted name, empty ones for fields without numbers."""
    import numpy as np

    numbers: dict[str, Any] = {}
    for key, value in structure.items():
        if isinstance(value, dict):
            numbers |= {
                f"{key}.{inner}": one
                for inner, one in _flatten_numeric_fields_by_dotted_name(value).items()
            }
            continue
        array = np.asarray(value.toarray() if hasattr(value, "toarray") else value)
        numbers[key] = array if array.dtype.kind in "biuf" else np.zeros(0)
    return numbers


if __name__ == "__main__":
    sys.exit(write_mat_structure_to_stdout(sys.argv[1]))

"""Read MATLAB files that others made in a separate process: SciPy dies of some damaged ones."""

import io
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.errors import InputError
from dpbench.files.regular_files import open_regular_file

MOST_MAT_BYTES = 2**25  # The largest vessel of the MSS toolbox has 2 MB
WAIT_S = 30.0  # For the process, which ends itself after `mat_child.TIME_S` of a processor
_ALLOWED = "a .mat file of version 7 or older (in MATLAB: save -v7)"


def read_mat_structure_in_child(path: Path, name: str) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Return the variable names and one structure's arrays of an untrusted MATLAB file.

    A child process reads them. The fields of the structure `name` have dotted names from `name` on;
    one without numbers is empty. For the name "" they are the variables of the file.

    InputError : it cannot be opened, is no such file, or reading it takes too long or too much.
    """
    program = [sys.executable, "-P", str(Path(__file__).with_name("mat_child.py")), name]
    # A thread of a BLAS library reserves more memory than the process may have.
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with open_regular_file(path, _ALLOWED, most_bytes=MOST_MAT_BYTES) as file:
        try:
            ended = subprocess.run(
                program, stdin=file, capture_output=True, timeout=WAIT_S, env=alone, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise InputError(
                str(path), "", f"a file that SciPy does not read within {WAIT_S:g} s", _ALLOWED
            ) from error
    if ended.returncode < 0:
        died = f"a file that crashes SciPy ({signal.Signals(-ended.returncode).name})"
        raise InputError(str(path), "", died, _ALLOWED)
    if ended.returncode:
        said = ended.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"]
        raise InputError(str(path), "", f"an unreadable MATLAB file ({said[-1][:200]})", _ALLOWED)
    with np.load(io.BytesIO(ended.stdout), allow_pickle=False) as arrays:
        fields = {key: arrays[key] for key in arrays.files}
    return fields.pop("names").tolist(), fields

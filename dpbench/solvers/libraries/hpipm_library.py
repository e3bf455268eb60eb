"""HPIPM's library in the casadi wheel: its BLASFEO, and its C structures through ctypes.

The BLASFEO in that wheel is a generic build, without vector instructions. HPIPM calls another build
where there is one that this processor can run and that has the same structures: the file named by
the environment variable `DPBENCH_BLASFEO`, else that of the package `comma-deps-acados`.
"""

import ctypes
import os
from _ctypes import dlclose
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from hashlib import sha256
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dpbench.errors import DpbenchError, InputError
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim
from dpbench.solvers.contract import Build, Options

VARIABLE = "DPBENCH_BLASFEO"
CASADI = "casadi"
"""Value of the variable for casadi's own build."""
ACADOS_PACKAGE = "comma-deps-acados"
PATH_IN_ACADOS = "install/lib/libblasfeo.so"
NEEDED_NAMES = ("libblasfeo.so.0", "libblasfeo.so")
"""Names by which libhpipm looks for BLASFEO, first in its own folder."""
# BLASFEO writes less: names of four vector instructions at most.
TEXT_BYTES = 256
# More than the size of a structure of BLASFEO, and of the memory of a matrix of 9 x 6 numbers.
STRUCTURE_BYTES, MATRIX_BYTES = 256, 4096
MODES = ("SPEED_ABS", "SPEED", "BALANCE", "ROBUST")
INTEGERS = ("iter_max", "pred_corr", "cond_pred_corr", "kkt_fact_alg", "ric_alg")
STATUS = {
    0: Status.SOLVED,
    1: Status.MAX_ITERATIONS,
    2: Status.NUMERICAL_ERROR,  # step length at its minimum
    3: Status.NUMERICAL_ERROR,  # NaN in the solution
    4: Status.PRIMAL_INFEASIBLE,  # inconsistent equalities
}


class HpipmLibrary(NamedTuple):
    """The loaded library of HPIPM, and the build of the BLASFEO that it calls."""

    functions: ctypes.CDLL
    build: Build


class LibraryFile(NamedTuple):
    """A shared library of BLASFEO, and the words that name it beside its instruction set."""

    path: Path
    origin: str


@cache
def load_hpipm() -> HpipmLibrary:
    """Load HPIPM on the fastest BLASFEO that passes all checks; return it with its build.

    One process can load only one build. InputError: the file named by `DPBENCH_BLASFEO` is missing
    or unsuitable; DpbenchError: HPIPM solves a small QP wrongly on it.
    """
    casadi = Path(str(import_module("casadi").__file__)).parent
    named = os.environ.get(VARIABLE, "")
    chosen = _find_other_blasfeo(named)
    fault = "" if chosen is None else find_fault_of_blasfeo(chosen.path, casadi / "libblasfeo.so")
    if fault and named:
        allowed = "a BLASFEO library that casadi's HPIPM can use"
        raise InputError(VARIABLE, "", f"{named} ({fault})", allowed)
    if chosen is None or fault:
        # Some releases of casadi do not name the folder of BLASFEO in libhpipm.
        ctypes.CDLL(str(casadi / "libblasfeo.so"))
        functions = ctypes.CDLL(str(casadi / "libhpipm.so"))
        return HpipmLibrary(functions, read_instruction_set_of_blasfeo(functions))
    # Loading it with its names open to all libraries would be simpler, but PIQP's factorisation by
    # stages brings another BLASFEO of the same names, would call this one and corrupt memory.
    with TemporaryDirectory() as folder:
        for name in NEEDED_NAMES:
            Path(folder, name).symlink_to(chosen.path)
        Path(folder, "libhpipm.so").symlink_to(casadi / "libhpipm.so")
        functions = ctypes.CDLL(f"{folder}/libhpipm.so")
    if not _solves_small_qp(functions):
        found = f"HPIPM solves a QP of 9 variables wrongly on {chosen.path}"
        raise DpbenchError(f"{found}; use casadi's build with {VARIABLE}={CASADI}")
    build = read_instruction_set_of_blasfeo(functions)
    # Where casadi itself has loaded HPIPM before, that one is in use, with casadi's BLASFEO.
    if _find_address(functions) == _find_address(ctypes.CDLL(str(chosen.path))):
        build = replace(build, text=f"{build.text} {chosen.origin}")
    return HpipmLibrary(functions, build)


def _find_address(library: ctypes.CDLL) -> int | None:
    """Return the address of a function of the BLASFEO that a loaded library is or calls."""
    return ctypes.cast(library.blasfeo_processor_library_features, ctypes.c_void_p).value


def _find_other_blasfeo(named: str) -> LibraryFile | None:
    """Return the BLASFEO to load instead of casadi's: the named file, or that of acados's wheel."""
    if named == CASADI:
        return None
    if named:
        path = Path(named).resolve()
        if not path.is_file():
            raise InputError(VARIABLE, "", named, f'a shared library of BLASFEO, or "{CASADI}"')
        return LibraryFile(path, f"of {path.name} {sha256(path.read_bytes()).hexdigest()[:8]}")
    package = find_spec("acados")
    for folder in (package and package.submodule_search_locations) or ():
        path = Path(folder, PATH_IN_ACADOS).resolve()
        if path.is_file():
            try:
                return LibraryFile(path, f"of {ACADOS_PACKAGE} {metadata.version(ACADOS_PACKAGE)}")
            except metadata.PackageNotFoundError:
                return None
    return None


def find_fault_of_blasfeo(path: Path, known: Path) -> str:
    """Return why HPIPM cannot use a BLASFEO in place of the `known` one; "" if it can.

    Both are unloaded again: libhpipm would take the one that is loaded.
    """
    handles: list[int] = []
    try:
        libraries = []
        for each in (path, known):
            libraries.append(library := ctypes.CDLL(str(each)))
            handles.append(library._handle)
        other, own = libraries
        features = [ctypes.c_int(), ctypes.c_int()]
        other.blasfeo_processor_library_features(ctypes.byref(features[0]))
        other.blasfeo_processor_cpu_features(ctypes.byref(features[1]))
        if features[0].value & ~features[1].value:
            return "this processor lacks instructions that it uses"
        memory = ctypes.create_string_buffer(MATRIX_BYTES)
        if _list_structures(other, memory) != _list_structures(own, memory):
            return "its matrices have another layout in memory than casadi's"
    except (OSError, AttributeError) as error:
        return str(error)
    finally:
        for handle in handles:
            dlclose(handle)
    return ""


def _list_structures(library: Any, memory: Any) -> list[tuple[int, list[int]]]:
    """Return memory size and contents of a matrix and of a vector of a BLASFEO, word by word."""
    structures = []
    for kind, sizes in (("dmat", (9, 6)), ("dvec", (9,))):
        words = (ctypes.c_uint64 * (STRUCTURE_BYTES // 8))()
        memsize = getattr(library, f"blasfeo_memsize_{kind}")
        memsize.restype = ctypes.c_size_t
        getattr(library, f"blasfeo_create_{kind}")(*sizes, words, memory)
        structures.append((memsize(*sizes), list(words)))
    return structures


def _solves_small_qp(functions: ctypes.CDLL) -> bool:
    """Return whether HPIPM finds the known optimum of a QP of 9 variables, two of them limited.

    P = I + 1 1ᵀ, |z| ≤ 1, z* = −1 … 1 in equal steps, with multipliers −½ and ½ at its ends.
    """
    n = 9
    optimum = np.linspace(-1.0, 1.0, n)
    multipliers = np.zeros(n)
    multipliers[0], multipliers[-1] = -0.5, 0.5
    P = np.eye(n) + np.ones((n, n))
    parts = HpipmStructures(functions, "dense_qp", (n, 0, n, 0, 0), {})
    arrays: dict[str, NDArray[Any]] = {
        "H": P,
        "g": -P @ optimum - multipliers,
        "idxb": np.arange(n, dtype=np.intc),
        "lb": -np.ones(n),
        "ub": np.ones(n),
    }
    for function, address in parts.pair_arrays_with_hpipm_functions("set", arrays):
        function(address, parts.qp)
    parts.run_hpipm()
    found = np.empty(n)
    parts.look_up_hpipm_function("sol_get_v")(parts.sol, make_c_pointer_to_array(found))
    return bool(np.abs(found - optimum).max() < 1e-5)


def read_instruction_set_of_blasfeo(library: Any) -> Build:
    """Return the instruction set of a loaded BLASFEO; an empty build if it states none."""
    if not hasattr(library, "blasfeo_processor_library_features"):
        return Build()
    features, text = ctypes.c_int(), ctypes.create_string_buffer(TEXT_BYTES)
    library.blasfeo_processor_library_features(ctypes.byref(features))
    if features.value == 0:
        return Build("BLASFEO generic", generic=True)
    library.blasfeo_processor_library_string(text)
    return Build(f"BLASFEO {' '.join(text.value.decode('ascii').split())}")


class HpipmStructures:
    """The C structures and memory in which HPIPM solves QPs of one size.

    kind : "dense_qp" or "ocp_qp".
    sizes : the arguments of `dim_set_all`; options : settings by name.
    stages : what the structure of the sizes is made of: nothing, or the number of the last stage.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        kind: str,
        sizes: tuple[Any, ...],
        options: Options,
        *stages: int,
    ) -> None:
        self._library, self._kind = library, f"d_{kind}"
        self._memory: list[Any] = []
        self.dim = self._create_c_structure("_dim", *stages)
        self.look_up_hpipm_function("dim_set_all")(*sizes, self.dim)
        self.qp, self.sol = (self._create_c_structure(k, self.dim) for k in ("", "_sol"))
        solved = self._create_structures_to_solve()
        self.arg = self._create_c_structure("_ipm_arg", solved)
        self._write_mode_and_options(dict(options))
        # Its size depends on the arguments.
        self.ws = self._create_c_structure("_ipm_ws", solved, self.arg)
        self._solve = self.look_up_hpipm_function("ipm_solve")
        self._set_warm_start = self.look_up_hpipm_function("ipm_arg_set_warm_start")
        self._warm_flags = [ctypes.byref(ctypes.c_int(flag)) for flag in (0, 1)]
        self._flag, self._count = ctypes.c_int(), ctypes.c_int()
        self._getters = [
            (self.look_up_hpipm_function("ipm_get_status"), ctypes.byref(self._flag)),
            (self.look_up_hpipm_function("ipm_get_iter"), ctypes.byref(self._count)),
        ]

    def look_up_hpipm_function(self, name: str) -> Any:
        """Return HPIPM's C function of this name, for dense or stage-wise QPs."""
        return getattr(self._library, f"{self._kind}_{name}")

    def pair_arrays_with_hpipm_functions(
        self, verb: str, arrays: Mapping[str, NDArray[Any]]
    ) -> list[tuple[Any, Any]]:
        """Return each nonempty array's address, with the HPIPM function that sets or gets it."""
        named = [(name, array) for name, array in arrays.items() if array.size]
        return [
            (self.look_up_hpipm_function(f"{verb}_{name}"), make_c_pointer_to_array(array))
            for name, array in named
        ]

    def select_warm_start(self, given: bool) -> None:
        """Select whether HPIPM's next solve starts from the values in its solution structure."""
        self._set_warm_start(self._warm_flags[given], self.arg)

    def _create_structures_to_solve(self) -> Any:
        """Return the sizes of the QP that HPIPM solves, which is the given one."""
        return self.dim

    def run_hpipm(self) -> None:
        """Run HPIPM on the QP in its structures."""
        self._solve(self.qp, self.sol, self.arg, self.ws)

    def read_status_and_iterations(self) -> Claim:
        """Return status and iterations of HPIPM's last solve."""
        for function, target in self._getters:
            function(self.ws, target)
        flag = self._flag.value
        return STATUS.get(flag, Status.UNKNOWN), self._count.value, -1, f"status {flag}"

    def _write_mode_and_options(self, options: dict[str, Any]) -> None:
        """Write HPIPM's mode and options into its argument structure."""
        mode = MODES.index(str(options.pop("mode", "SPEED")))
        self.look_up_hpipm_function("ipm_arg_set_default")(mode, self.arg)
        for name, value in options.items():
            number: Any = ctypes.c_int if name in INTEGERS else ctypes.c_double
            self.look_up_hpipm_function(f"ipm_arg_set_{name}")(
                ctypes.byref(number(value)), self.arg
            )

    def _create_c_structure(self, kind: str, *parts: Any) -> Any:
        """Return a newly allocated C structure of HPIPM of a kind, such as a solution."""
        library, prefix = self._library, f"{self._kind}{kind}"
        sizes = [getattr(library, f"{prefix}_{name}") for name in ("strsize", "memsize")]
        for function in sizes:
            function.restype = ctypes.c_size_t
        structure = ctypes.create_string_buffer(sizes[0]())
        memory = ctypes.create_string_buffer(sizes[1](*parts))
        self._memory += [structure, memory]
        getattr(library, f"{prefix}_create")(*parts, structure, memory)
        return structure


def make_c_pointer_to_array(array: NDArray[Any]) -> Any:
    """Return the memory address of an array as a C void pointer that keeps the array alive."""
    return array.ctypes.data_as(ctypes.c_void_p)


class CondensedStructures(HpipmStructures):
    """The structures of a QP by stages that HPIPM condenses in blocks of stages before it solves.

    stages_per_block : number of consecutive stages in each block; their sum is that of all stages.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        sizes: tuple[Any, ...],
        options: Options,
        stages_per_block: list[int],
    ) -> None:
        self._last_block = len(stages_per_block) - 1
        # HPIPM counts the steps from stage to stage, of which the last block has one less.
        counts = [*stages_per_block[:-1], stages_per_block[-1] - 1]
        self._counts = (ctypes.c_int * len(counts))(*counts)
        self._warm = self._is_condensed = False
        super().__init__(library, "ocp_qp", sizes, options, sum(counts))

    def _create_structures_to_solve(self) -> Any:
        """Create the structures of the condensed QP; return its sizes."""
        last, counts = self._last_block, self._counts
        small = self._create_c_structure("_dim", last)
        self._library.d_part_cond_qp_compute_dim(self.dim, counts, small)
        self._small_qp, self._small_sol = (self._create_c_structure(k, small) for k in ("", "_sol"))
        self._condensing_arg = self._create_unsized_structure("_arg", last)
        self._library.d_part_cond_qp_arg_set_default(self._condensing_arg)
        # Its default, by square roots, is wrong where the cost of the states is semidefinite.
        self._library.d_part_cond_qp_arg_set_ric_alg(0, self._condensing_arg)
        sizes = self.dim, counts, small, self._condensing_arg
        self._condensing_ws = self._create_unsized_structure("_ws", *sizes)
        return small

    def _create_unsized_structure(self, kind: str, *parts: Any) -> Any:
        """Return a new C structure of partial condensing, which has no function for its size."""
        memsize = getattr(self._library, f"d_part_cond_qp{kind}_memsize")
        memsize.restype = ctypes.c_size_t
        structure = ctypes.create_string_buffer(STRUCTURE_BYTES)
        memory = ctypes.create_string_buffer(memsize(*parts))
        self._memory += [structure, memory]
        getattr(self._library, f"d_part_cond_qp{kind}_create")(*parts, structure, memory)
        return structure

    def select_warm_start(self, given: bool) -> None:
        """Select whether HPIPM's next solve starts from the values in its solution structure."""
        super().select_warm_start(given)
        self._warm = given

    def run_hpipm(self) -> None:
        """Condense the QP, its vectors alone after the first time; solve it; expand the answer."""
        library, workspaces = self._library, (self._condensing_arg, self._condensing_ws)
        condense = (
            library.d_part_cond_qp_cond_rhs if self._is_condensed else library.d_part_cond_qp_cond
        )
        condense(self.qp, self._small_qp, *workspaces)
        self._is_condensed = True
        if self._warm:
            library.d_part_cond_qp_cond_sol(
                self.qp, self._small_qp, self.sol, self._small_sol, *workspaces
            )
        self._solve(self._small_qp, self._small_sol, self.arg, self.ws)
        library.d_part_cond_qp_expand_sol(self.qp, self._small_sol, self.sol, *workspaces)

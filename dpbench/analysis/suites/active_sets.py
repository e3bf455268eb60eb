"""Counts of the active sets that a controller's QPs visit, and of those not seen yet.

An explicit MPC stores one law for each active set. Of the sets that a run visits, those seen once
tell how often a further step would meet one that is not stored: the unseen mass is estimated by
F₁/K, with F₁ the sets seen in exactly one of K steps (Good 1953, Biometrika 40, 237-264), and its
standard error by √(F₁ (1 − F₁/K) + 2 F₂) / K (Esty 1983, Annals of Statistics 11, 905-912).
Neighbouring steps visit equal sets more often than independent ones, so that the error is larger.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Floats
from dpbench.bench.sequences.source import load_named_sequence, record_scenario
from dpbench.embedded.recipe import find_recipes
from dpbench.embedded.toolchain import find_target_by_name, require_extra
from dpbench.errors import InputError, UnknownNameError
from dpbench.qp.program import QPSequence
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.scenario.problem_files import list_shipped_problem_names, make_unknown_qps_name_error
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.active_set_memory import ActiveSetMemoryWorkspace

_ZERO = 1e-9
"""Multipliers below this share of the largest one, or of 1, are those of no active limit."""


@dataclass(frozen=True)
class VisitedSets:
    """Counts of the visits of active sets over `steps` QPs of n variables.

    sets : different ones; once, twice : sets seen in exactly one and two steps; most_active :
    limits of the largest; table_bytes : of the affine laws of all, in double precision.
    """

    name: str
    n: int
    steps: int
    sets: int
    once: int
    twice: int
    most_active: int
    table_bytes: int

    @property
    def unseen_mass(self) -> float:
        """Share of further steps whose set was not visited, by Good and Turing."""
        return self.once / self.steps

    @property
    def unseen_error(self) -> float:
        """Standard error of the unseen mass, as of independent steps."""
        spread = self.once * (1.0 - self.once / self.steps) + 2.0 * self.twice
        return float(np.sqrt(spread)) / self.steps


def count_visited_sets(name: str, n: int, optima: Sequence[Optimum]) -> VisitedSets:
    """Count the active sets of certified optima of QPs of n variables; without one, not counted."""
    visits: Counter[bytes] = Counter()
    sizes: dict[bytes, int] = {}
    for optimum in optima:
        if not np.isfinite(optimum.bound):
            continue
        multipliers = np.concatenate([optimum.y_box, optimum.y])
        zero = _ZERO * max(1.0, float(np.abs(multipliers).max()))
        side = np.where(np.abs(multipliers) > zero, np.sign(multipliers), 0.0).astype(np.int8)
        visits[side.tobytes()] += 1
        sizes[side.tobytes()] = int(np.count_nonzero(side))
    times = Counter(visits.values())
    return VisitedSets(
        name,
        n,
        steps=visits.total(),
        sets=len(visits),
        once=times[1],
        twice=times[2],
        most_active=max(sizes.values(), default=0),
        # z = base − back λ and λ = gain [base; g] (`solvers/own/active_set_memory.py`).
        table_bytes=sum(8 * k * (2 * n + k) + 4 * k for k in sizes.values()),
    )


def count_visited_sets_of(name: str) -> VisitedSets:
    """Count the active sets of a scenario's reference loop, or of a stored sequence.

    Raises
    ------
    InputError : for a name of neither, or QPs whose matrices change, as one law holds for one P.
    """
    sequence, optima = _load_with_constant_matrices(name)
    return count_visited_sets(sequence.name, sequence.base.n, optima)


@dataclass(frozen=True, eq=False)
class SavedWork:
    """Work that a memory of active sets saves along K QPs.

    answered : (K,) whether a stored law answered the step.
    instructions : (K,) of the paper's method, warm, as C on an emulated Cortex-M7.
    multiply_adds : (K,) of the laws that the memory tries, with their checks.
    """

    name: str
    answered: NDArray[np.bool_]
    instructions: Floats
    multiply_adds: Floats

    @property
    def least_instructions(self) -> Floats:
        """Least instructions of each step with a memory (K,): one for each multiply-add.

        A core takes more, as it loads the numbers.
        """
        return self.multiply_adds + np.where(self.answered, 0.0, self.instructions)


def count_saved_work(name: str) -> SavedWork:
    """Count what a memory of active sets saves in the QPs of a scenario or a sequence.

    InputError as of `count_visited_sets_of`; errors of `count_instructions_along_sequence`.
    """
    require_extra()
    # The emulator takes a while to load.
    from dpbench.embedded.count import count_instructions_along_sequence

    sequence, optima = _load_with_constant_matrices(name)
    workspace = open_workspace("active_set_memory", policy="warm")
    assert isinstance(workspace, ActiveSetMemoryWorkspace)
    workspace.setup(sequence.base)
    hits, multiply_adds = [0], []
    for k in range(len(sequence)):
        workspace.update(sequence.step(k))
        workspace.solve()
        hits.append(workspace.hits)
        multiply_adds.append(float(workspace.multiply_adds))
    recipe, core = find_recipes()["paper_active_set"], find_target_by_name("m7")
    counted = count_instructions_along_sequence(recipe, sequence, core, optima=optima)
    instructions = counted.steps["instructions"].astype(np.float64)
    return SavedWork(sequence.name, np.diff(hits) > 0, instructions, np.array(multiply_adds))


def _load_with_constant_matrices(name: str) -> tuple[QPSequence, Sequence[Optimum]]:
    """Return QPs by name, with their optima; InputError where their matrices change."""
    sequence, optima = _load(name)
    if sequence.P is not None or sequence.A is not None:
        found = f"{name}, whose matrices change from step to step"
        raise InputError("active-sets", "", found, "QPs with constant matrices")
    return sequence, optima


def _load(name: str) -> tuple[QPSequence, Sequence[Optimum]]:
    """Return the QPs of a scenario's reference loop or of a sequence, with their optima."""
    if name in list_shipped_problem_names("scenarios") or Path(name).suffix == ".toml":
        recorded = record_scenario(load_scenario(name))
    else:
        try:
            recorded = load_named_sequence(name)
        except UnknownNameError as error:
            raise make_unknown_qps_name_error(name) from error
    sequence = recorded.sequence.scaled or recorded.sequence
    return sequence, recorded.optima or certify_all_steps(sequence)

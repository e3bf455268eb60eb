"""What both interfaces of HPIPM do alike from step to step."""

from __future__ import annotations

from abc import abstractmethod

from dpbench.arrays import Vector
from dpbench.solvers.adapter import Claim
from dpbench.solvers.contract import Options, Policy
from dpbench.solvers.libraries.hpipm.library import Structures, load_library
from dpbench.solvers.libraries.native_workspace import NativeWorkspace
from dpbench.solvers.one_sided import Sides
from dpbench.solvers.record import SolverRecord


class HpipmWorkspace(NativeWorkspace):
    """HPIPM on limits of [A; I], `_low` and `_high`; another `_pattern` of them is set up anew.

    `_build` makes `_parts`; `_fill` hands over a gradient and the limits, `_place_start` the start.
    """

    _parts: Structures
    _pattern: bytes | None = None

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = load_library()

    @abstractmethod
    def _fill(self, q: Vector) -> None:
        """Give HPIPM a gradient and the limits."""

    @abstractmethod
    def _place_start(self) -> None:
        """Give HPIPM the variables of `_start`."""

    def _convert(self) -> None:
        self._low, self._high = self._limits_of_all()

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        if Sides.pattern(low, high) != self._pattern:
            self._build_for(q, low, high)
            return
        m = self._m
        self._low[:m], self._high[:m] = low, high
        self._fill(q)
        if self._warm:
            given = self._start.advance()
            if given:
                self._place_start()
            self._parts.start_warm(given)

    def _call(self) -> None:
        self._parts.solve()

    def _claimed(self) -> Claim:
        return self._parts.outcome()

"""Tell faults of a custom plant from those of a solver."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from dpbench.bench.run.assemble import clock
from dpbench.bench.run.steered import plant_observers
from dpbench.bench.workers.shared_status import Phase, set_fmu, set_phase


class PlantWatch:
    """Observer of a custom plant, so that its faults are told from those of a solver.

    after : phase of the process between calls of the plant. fmu : file name of the FMU that is the
    plant; "" for none. call_limit_s : time of one call after which the kernel ends the process,
    where no supervisor limits it; 0 for none.
    """

    def __init__(self, after: Phase, fmu: str, call_limit_s: float = 0.0) -> None:
        self._after, self._call_limit_s, self._since_ns = after, call_limit_s, 0
        self.spent_ns = 0
        set_fmu(fmu)

    @contextmanager
    def observe(self) -> Iterator[None]:
        """Observe the plants of the block."""
        plant_observers.append(self._note_call)
        try:
            yield
        finally:
            plant_observers.remove(self._note_call)

    def _note_call(self, begins: bool) -> None:
        """Note the begin or the end of a call of the plant."""
        now_ns = clock()
        if self._call_limit_s:
            # The default of this signal ends a process also while it is in foreign code.
            signal.setitimer(signal.ITIMER_REAL, self._call_limit_s if begins else 0.0)
        set_phase(Phase.PLANT if begins else self._after)
        if begins:
            self._since_ns = now_ns
        else:
            self.spent_ns += now_ns - self._since_ns

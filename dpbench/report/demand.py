"""What a controller demands of a solver, as the suite writes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dpbench.report.formats import plural


@dataclass(frozen=True)
class Demand:
    """What a controller demands of a solver."""

    error_move: float = 1e-2
    failed_steps: int = 0
    p99_ms: float = 3.0
    deadline_ms: float = 300.0

    @classmethod
    def of(cls, suite: dict[str, Any]) -> Demand:
        """The demand written in `suite.json`; defaults where it is silent."""
        known = {k: v for k, v in suite.get("demand", {}).items() if k in cls.__annotations__}
        return cls(**known)

    @property
    def p99_ns(self) -> float:
        """Largest p99 of the algorithmic step time [ns]."""
        return self.p99_ms * 1e6

    @property
    def deadline_ns(self) -> float:
        """The deadline of a step [ns]."""
        return self.deadline_ms * 1e6


def demand_text(demand: Demand) -> str:
    """The demand in one sentence."""
    share = f"{100.0 * demand.p99_ms / demand.deadline_ms:.2g}"
    failed = (
        "no failed step"
        if demand.failed_steps == 0
        else (f"at most {plural(demand.failed_steps, 'failed step')} a run")
    )
    return (
        f"The demand: on every step the first move within {demand.error_move:g} of "
        f"a rate-limit step of the certified optimum, {failed}, and a p99 of the algorithmic "
        f"step time of at most {demand.p99_ms:g} ms ({share} % of the "
        f"{demand.deadline_ms / 1e3:g} s sample)."
    )

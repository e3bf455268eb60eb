"""Descriptions of a machine and of what disturbed its timings."""

from collections.abc import Sequence
from math import isnan

from dpbench.analysis.records.machine import find_largest_by_name
from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.judge.calibration import is_within_tolerance
from dpbench.bench.record.disturbance import Disturbance
from dpbench.bench.record.result_folder import MachineDescription
from dpbench.report.formats import (
    MISSING,
    format_count,
    format_share,
    format_time,
    join_with_and,
    significant,
)


def describe_disturbance(disturbance: Disturbance) -> str:
    """Return words on whether other programs disturbed timing: "quiet", or disturbed by what."""
    complaints = disturbance.complaints()
    return f"affected by other load: {join_with_and(complaints)}" if complaints else "quiet"


def describe_calibration(p50_ns: dict[str, float]) -> str:
    """Return words on how exactly the benchmark measured waits of known length."""
    missed = [name for name, p50 in p50_ns.items() if is_within_tolerance(name, p50) is False]
    wording = ", ".join(f"{name} {format_time(p50)}" for name, p50 in p50_ns.items())
    verdict = "known waits were measured within tolerance"
    if missed:
        verdict = (
            f"{join_with_and(missed)} measured outside the tolerance of 1 µs or 1 %; measure again "
            "on a quiet machine"
        )
    return f"{verdict} (p50: {wording})"


def list_machine_facts(machine: MachineDescription) -> list[tuple[str, str]]:
    """Return label and text of a machine's processor, cores, frequency, BLAS and clock."""

    def of(key: str, unit: str = "") -> str:
        value = machine.get(key, "not recorded")
        if not unit or not isinstance(value, int | float):
            return str(value)
        return f"{value:,g} {unit}".replace(",", "\u202f")

    cores = [str(core) for core in machine.get("affinity") or []]
    vectors = ", ".join(machine.get("vector_instructions", [])) or "not recorded"
    return [
        ("processor", f"{of('cpu_model')}, {of('cores')} cores"),
        ("processor family", of("cpu_family")),
        ("vector instructions", vectors),
        ("cores used (numbers)", ", ".join(cores) or "not recorded"),
        ("frequency governor", of("governor")),
        ("frequency at the start", of("frequency_MHz", "MHz")),
        ("throttle events", of("throttle_counters")),
        ("BLAS", ", ".join(machine.get("blas") or ["none found"])),
        ("time to read the clock", of("clock_read_ns", "ns")),
        ("resolution of the clock", of("timer_resolution_ns", "ns")),
    ]


def list_disturbance_facts(disturbance: Disturbance) -> list[tuple[str, str]]:
    """Return label and text of what disturbed replays: switches, stolen time, throttling."""
    disturbed = f"{format_count(disturbance.disturbed)} of {format_count(disturbance.rounds)}"
    throttled, steal_share = format_count(disturbance.throttled), disturbance.steal_share
    stolen = "not visible" if isnan(steal_share) else format_share(steal_share)
    return [
        (
            "disturbed rounds",
            f"{disturbed}; {format_count(disturbance.rerun)} repeated",
        ),
        (
            "involuntary context switches",
            f"{significant(disturbance.switches_per_s, 3)} per second",
        ),
        ("time stolen by the host", stolen),
        ("throttle events", "not visible" if throttled == MISSING else throttled),
    ]


def list_switching_solvers(rows: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """Return label and text of each solver that causes context switches itself."""
    own = find_largest_by_name(
        (f"{row.solver} ({row.route} {row.policy})", row.own_switches_a_step) for row in rows
    )
    wording = ", ".join(
        f"{name}: {significant(a_step, 2)} per step" for name, a_step in own.items()
    )
    return [("context switches caused by the solver itself", wording)] if own else []

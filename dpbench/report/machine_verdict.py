"""The verdict on the machine: how quiet it was while replays were timed, what is known of it."""

from collections.abc import Sequence
from math import isnan

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.times.machine import largest_by_name
from dpbench.bench.judge.calibration import is_within_tolerance
from dpbench.bench.record.disturbance import Disturbance
from dpbench.bench.record.result_folder import MachineDescription
from dpbench.report.formats import (
    MISSING,
    format_count,
    format_share,
    format_time,
    join_with_and,
    plural,
    significant,
)


def describe_disturbance(disturbance: Disturbance) -> str:
    """Describe whether other programs disturbed the timing: "quiet", or disturbed by what."""
    complaints = disturbance.complaints()
    return f"disturbed: {join_with_and(complaints)}" if complaints else "quiet"


def describe_calibration(p50_ns: dict[str, float]) -> str:
    """Describe how exactly the benchmark measured waits of known length."""
    missed = [name for name, p50 in p50_ns.items() if is_within_tolerance(name, p50) is False]
    wording = ", ".join(f"{name} {format_time(p50)}" for name, p50 in p50_ns.items())
    verdict = f"missed by {join_with_and(missed)}" if missed else "within the bar"
    return f"{verdict} ({wording})"


def list_machine_facts(machine: MachineDescription) -> list[tuple[str, str]]:
    """List a machine's processor, cores, frequency, BLAS and clock, as label and text."""

    def of(key: str, unit: str = "") -> str:
        value = machine.get(key, "not recorded")
        return f"{value} {unit}" if unit and isinstance(value, int | float) else str(value)

    cores = [str(core) for core in machine.get("affinity") or []]
    return [
        ("processor", f"{of('cpu_model')}, {of('cores')} cores"),
        ("cores allowed", ", ".join(cores) or "not recorded"),
        ("frequency governor", of("governor")),
        ("frequency at the start", of("frequency_MHz", "MHz")),
        ("throttle counters", of("throttle_counters")),
        ("BLAS", ", ".join(machine.get("blas") or ["none seen"])),
        ("reading the clock", of("clock_read_ns", "ns")),
        ("resolution of the clock", of("timer_resolution_ns", "ns")),
    ]


def list_disturbance_facts(disturbance: Disturbance) -> list[tuple[str, str]]:
    """List what disturbed replays, as label and text: context switches, stolen time, throttling."""
    disturbed = f"{format_count(disturbance.disturbed)} of {plural(disturbance.rounds, 'round')}"
    throttled, steal_share = format_count(disturbance.throttled), disturbance.steal_share
    stolen = "not visible" if isnan(steal_share) else format_share(steal_share)
    return [
        ("disturbed rounds left", f"{disturbed}; {format_count(disturbance.rerun)} run again"),
        ("involuntary context switches", f"{significant(disturbance.switches_per_s, 2)} a second"),
        ("time stolen by the host", stolen),
        ("throttle events", "not visible" if throttled == MISSING else throttled),
    ]


def list_switching_solvers(rows: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """List the solvers that cause context switches themselves, as label and text."""
    own = largest_by_name(
        (f"{row.solver} ({row.route} {row.policy})", row.own_switches_a_step) for row in rows
    )
    wording = ", ".join(f"{name}: {significant(a_step, 2)} a step" for name, a_step in own.items())
    return [("switches a configuration makes itself, not counted above", wording)] if own else []

"""Text of `dpbench doctor`: this machine, whether it is quiet, and whether the harness is right."""

from dpbench.bench.judge.calibration import time_dummy_solvers
from dpbench.bench.record.disturbance import QUIET_RULE
from dpbench.bench.record.energy import find_energy_counters
from dpbench.bench.record.machine import describe_machine
from dpbench.cli.terminal import wrap_paragraph
from dpbench.report.formats import MISSING
from dpbench.report.verdict import machine_text as verdict
from dpbench.solvers.releases import find_newer_releases
from dpbench.solvers.table import find_solver_availability, list_all_solver_names

_WIDTH = 32
_INDEX_TIMEOUT_S = 5.0
"""Longest wait for the package index [s]."""


def describe_machine_and_clock(*, offline: bool) -> list[str]:
    """Return lines on this machine, how quiet it is, whether solve times are measured rightly.

    offline : do not ask the package index for newer releases of the solvers.
    """
    machine = describe_machine()
    harness = time_dummy_solvers()
    available = ((name, find_solver_availability(name)) for name in list_all_solver_names())
    builds = [f"{name} {here.build.text}" for name, here in available if here.build.text]
    loads = ", ".join(f"{load:.2f}" for load in machine["load_average"])
    without = find_energy_counters().missing
    facts = [
        *verdict.list_machine_facts(machine),
        ("memory", f"{machine['memory_GiB']} GiB"),
        ("system", f"{machine['kernel']}, {machine['python']}"),
        ("versions", ", ".join(f"{k} {v}" for k, v in machine["versions"].items())),
        ("solver builds", ", ".join(builds) or MISSING),
        ("load average", loads or MISSING),
        ("energy counters", f"not visible: {without}" if without else "readable"),
        *verdict.list_disturbance_facts(harness.disturbance),
    ]
    # After the measurement, which pip would disturb.
    newer = [] if offline else find_newer_releases(_INDEX_TIMEOUT_S)
    facts += [("newer releases", ", ".join(map(str, newer)))] if newer else []
    verdicts = (
        f"This machine is {verdict.describe_disturbance(harness.disturbance)}",
        f"Limits for a quiet machine: {QUIET_RULE}",
        f"Timing: {verdict.describe_calibration(harness.p50_ns)}",
    )
    blank = " " * _WIDTH
    lines = [wrap_paragraph(fact, first=f"{what:<{_WIDTH}}", others=blank) for what, fact in facts]
    return lines + [wrap_paragraph(text, others="  ") for text in verdicts]

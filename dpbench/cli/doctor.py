"""Text of `dpbench doctor`: this machine, whether it is quiet, and whether the harness is right."""

from dpbench.bench.judge.calibration import calibrate
from dpbench.bench.record.disturbance import QUIET_RULE
from dpbench.bench.record.machine import describe_machine
from dpbench.cli.terminal import wrapped
from dpbench.report.formats import MISSING
from dpbench.report.machine_verdict import (
    calibration_text,
    disturbance_facts,
    disturbance_text,
    machine_facts,
)
from dpbench.solvers.table import check_availability, solver_names

_WIDTH = 32


def doctor_lines() -> list[str]:
    """Return facts and verdicts, from a few seconds of the harness's own configurations.

    These run in this process, on the core that timed replays are pinned to.
    """
    machine = describe_machine()
    harness = calibrate()
    loads = ", ".join(f"{load:.2f}" for load in machine["load_average"])
    facts = [
        *machine_facts(machine),
        ("memory", f"{machine['memory_GiB']} GiB"),
        ("system", f"{machine['kernel']}, {machine['python']}"),
        ("versions", ", ".join(f"{k} {v}" for k, v in machine["versions"].items())),
        ("solver builds", _solver_builds() or MISSING),
        ("load average", loads or MISSING),
        *disturbance_facts(harness.disturbance),
    ]
    verdicts = (
        f"machine: {disturbance_text(harness.disturbance)}",
        f"quiet means: {QUIET_RULE}",
        f"harness: {calibration_text(harness.p50_ns)}",
    )
    return [
        *(wrapped(text, first=f"{what:<{_WIDTH}}", others=" " * _WIDTH) for what, text in facts),
        *(wrapped(text, others="  ") for text in verdicts),
    ]


def _solver_builds() -> str:
    """Name the instruction sets of the installed solvers that have builds for several."""
    libraries = {name: check_availability(name) for name in solver_names()}
    return ", ".join(
        f"{k} {library.build.text}" for k, library in libraries.items() if library.build.text
    )

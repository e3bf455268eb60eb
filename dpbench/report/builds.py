"""The mark of solvers whose library was built without its fast kernels, beside their times."""

from __future__ import annotations

from collections.abc import Iterable

from dpbench.report.view import Row

GENERIC = "†"


def timed_name(row: Row) -> str:
    """The solver of a row beside whose time it stands, marked where its build is a generic one."""
    return f"{row['solver']} {GENERIC}" if row["generic_build"] else str(row["solver"])


def build_legend(rows: Iterable[Row]) -> str:
    """What the mark means, in a sentence with a space before it; "" where no row has it."""
    builds = sorted({str(row["build"]) for row in rows if row["generic_build"]})
    if not builds:
        return ""
    return (
        f" {GENERIC}: {', '.join(builds)}: the library has kernels for this kind of processor, and "
        "the build that is installed leaves them out; its times are not those of a build for it."
    )

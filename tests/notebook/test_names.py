"""Names of solvers: a list, shown as a table of what decides whether one can be used."""

import re
from typing import get_args

from dpbench import list_solvers
from dpbench.solvers.contract import Family
from dpbench.solvers.table import TABLE


def test_solvers_are_names_that_show_as_a_table() -> None:
    names = list_solvers()
    assert isinstance(names, list) and {*TABLE} <= {*names} and names == sorted(names)
    head, *lines = repr(names).splitlines()
    assert re.split(r"  +", head) == ["solver", "version", "kind", "licence", "call modes"]
    rows = {row[0]: row for row in (re.split(r"  +", line) for line in lines)}
    assert list(rows) == names
    _, _, kind, licence, modes = rows["daqp"]
    assert (kind, licence) == ("active set", "MIT")
    assert modes == "qpsolvers: fresh, warm; native: fresh, reuse, warm"
    assert {row[2] for row in rows.values()} <= {*get_args(Family)}
    html = names._repr_html_()
    assert html.count("<tr>") == 1 + len(names) and "<td>MIT</td>" in html

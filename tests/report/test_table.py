"""Tables of the terminal and of comparisons."""

import pytest

from dpbench.report.table import Table, markdown, row_of


def test_a_ragged_table_is_refused() -> None:
    """Every row has as many cells as there are heads."""
    with pytest.raises(ValueError, match="expected 2 cells, found 1"):
        Table("t", "", ("a", "b"), (row_of("1"),))


def test_pipes_do_not_break_markdown() -> None:
    """A pipe in a reason stays inside its cell."""
    assert markdown(Table("t", "", ("a",), (row_of("x | y"),))).endswith("| x \\| y |")

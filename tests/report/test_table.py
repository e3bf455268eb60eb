"""Tables of the terminal and of comparisons."""

from dpbench.report.table import markdown


def test_pipes_do_not_break_markdown() -> None:
    """A pipe in a reason stays inside its cell; numbers after the first column stand right."""
    text = markdown(("a", "b"), (("x | y", "1"),))
    assert text.splitlines() == ["| a | b |", "| :-- | --: |", "| x \\| y | 1 |"]

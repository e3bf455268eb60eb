"""Counts of the same machine code by Unicorn, and by callgrind or QEMU where installed."""

import shutil

import numpy as np
import pytest

from dpbench.bench.sequences.sequence_file import load_sequence
from dpbench.bench.sequences.source import thin_sequence
from dpbench.embedded import count
from dpbench.embedded.count import TOOLS, SecondOpinion, compare_counts_with_second_tool
from dpbench.embedded.recipe import select_recipes
from dpbench.embedded.toolchain import TARGETS
from dpbench.errors import SituationError

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("embedded_extra")]


@pytest.mark.parametrize("target", TOOLS)
def test_counts_and_answers_are_those_of_another_tool(target: str) -> None:
    if shutil.which(TOOLS[target]) is None:
        pytest.skip(f"{TOOLS[target]} is not installed")
    sequence = thin_sequence(load_sequence("paper-30-5"), 2)
    (recipe,) = select_recipes(["hildreth"])
    opinion = compare_counts_with_second_tool(recipe, sequence, TARGETS[target])
    assert opinion.has_equal_answers_and_counts
    assert (opinion.others > 1000).all()


def test_what_counts_as_agreement() -> None:
    counts = np.array([1000, 2000])
    assert SecondOpinion("valgrind", counts, counts, 0).has_equal_answers_and_counts
    assert not SecondOpinion("valgrind", counts, counts + 1, 0).has_equal_answers_and_counts
    assert not SecondOpinion("valgrind", counts, counts, 1).has_equal_answers_and_counts
    assert SecondOpinion("qemu-arm", counts, counts + 10, 0).has_equal_answers_and_counts
    assert not SecondOpinion("qemu-arm", counts, counts + 50, 0).has_equal_answers_and_counts


def test_a_tool_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    (recipe,) = select_recipes(["hildreth"])
    sequence = thin_sequence(load_sequence("paper-30-5"), 1)
    with pytest.raises(SituationError, match="RISC-V RV64GC: there is no other tool"):
        compare_counts_with_second_tool(recipe, sequence, TARGETS["riscv"])
    monkeypatch.setattr(count, "TOOLS", {"m7": "no-such-tool"})
    with pytest.raises(SituationError, match="Cortex-M7: no-such-tool is not installed"):
        compare_counts_with_second_tool(recipe, sequence, TARGETS["m7"])

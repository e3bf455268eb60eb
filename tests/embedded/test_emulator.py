"""Counters of emulated cores, and what the compiler and the emulator refuse."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dpbench.embedded import count
from dpbench.embedded.emulator import (
    DATA,
    STACK_SIZE,
    Core,
    Counts,
    EmulationError,
    read_program_from_elf_file,
)
from dpbench.embedded.toolchain import TARGETS, Target, compile_program, find_target_by_name
from dpbench.errors import SituationError, UnknownNameError

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("embedded_extra")]
MakeCore = Callable[[str, Target], Core]


@pytest.fixture
def make_core(tmp_path: Path) -> MakeCore:
    """A core with a program of these functions."""

    def make(text: str, target: Target) -> Core:
        source = tmp_path / "source.c"
        source.write_text(f'#include "embedded.h"\n{text}\n')
        return Core(read_program_from_elf_file(compile_program([source], target)), target)

    return make


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_counts_of_the_calibration_program(target: Target) -> None:
    count.verify_calibration_counts(target)


def test_wrong_counts_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(count, "THOUSAND", 999)
    with pytest.raises(EmulationError, match="Cortex-A53: embedded_set_up counts"):
        count.verify_calibration_counts.__wrapped__(TARGETS["a53"])


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_overlapping_moves_roots_and_heap(make_core: MakeCore, target: Target) -> None:
    text = """
    #include <math.h>
    #include <stdlib.h>
    #include <string.h>
    int embedded_set_up(embedded_qp *qp) {
        void *volatile first = malloc(100), *volatile second = calloc(3, 8);
        return first == second;
    }
    int embedded_step(embedded_qp *qp) {
        double *x = (double *)(qp + 1);
        memmove(x, x + 1, 7 * 8);
        memmove(x + 9, x + 8, 7 * 8);
        x[16] = sqrt(x[16]);
        x[17] = fabs(x[17]);
        return -3;
    }"""
    core = make_core(text, target)
    assert core.call_function_and_count("embedded_set_up", DATA)[0] == 0
    assert core.count_heap_bytes() == 112 + 32  # of multiples of 16
    place = DATA + 32 + 8 * target.bits // 8
    core.write_memory(place, np.array([*range(16), 2.0, -5.0]).tobytes())
    assert core.call_function_and_count("embedded_step", DATA)[0] == -3
    values = np.frombuffer(core.read_memory(place, 18 * 8)).tolist()
    assert values[:7] == [1, 2, 3, 4, 5, 6, 7]
    assert values[9:16] == [8, 9, 10, 11, 12, 13, 14]
    assert values[16:] == [np.sqrt(2.0), 5.0]


def test_an_endless_function_and_a_bad_address(
    make_core: MakeCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpbench.embedded.emulator.LONGEST_US", 100_000)
    text = """
    int embedded_set_up(embedded_qp *qp) { for (volatile int i = 0;; i++) {} }
    int embedded_step(embedded_qp *qp) { return *(volatile int *)0x70000000; }"""
    core = make_core(text, TARGETS["a53"])
    with pytest.raises(EmulationError, match=r"a53: embedded_set_up does not end within 0.1 s"):
        core.call_function_and_count("embedded_set_up", DATA)
    with pytest.raises(EmulationError, match="a53: embedded_step: Invalid memory read"):
        core.call_function_and_count("embedded_step", DATA)


def test_the_whole_stack_is_measured(make_core: MakeCore) -> None:
    text = """
    int embedded_set_up(embedded_qp *qp) { return 0; }
    int embedded_step(embedded_qp *qp) {
        volatile char x[100000];
        x[qp->n] = 1;
        return x[qp->m];
    }"""
    core = make_core(text, TARGETS["m7"])
    assert core.call_function_and_count("embedded_set_up", DATA)[1] == Counts(2, -1, -1, 0)
    core.write_memory(DATA, bytes(8))
    assert (
        100_000
        <= core.call_function_and_count("embedded_step", DATA)[1].stack
        < 100_100
        < STACK_SIZE
    )


def test_refused_source_and_unknown_target(make_core: MakeCore) -> None:
    with pytest.raises(SituationError, match=r"the compilation failed: .*undeclared"):
        make_core("int embedded_set_up(embedded_qp *qp) { return other; }", TARGETS["m7"])
    with pytest.raises(UnknownNameError, match="--target: found 'm8'; allowed: one of m7, a53"):
        find_target_by_name("m8")

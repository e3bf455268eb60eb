"""The raw log survives its writer."""

from pathlib import Path

import numpy as np

from dpbench.bench.record.raw_log import (
    RawLog,
    delete_log_and_layout,
    make_loop_layout,
    make_replay_layout,
)


def test_a_reader_sees_what_the_writer_assigned(tmp_path: Path) -> None:
    path = tmp_path / "cell.raw"
    writer = RawLog.create(path, make_loop_layout(steps=7, n=15, m=15, n_theta=16))
    writer.z[0, 3] = np.arange(15.0)
    writer.done[0] = 4
    reader = RawLog.open(path)
    assert int(reader.done[0]) == 4
    np.testing.assert_array_equal(reader.z[0, 3], np.arange(15.0))


def test_arrays_do_not_overlap() -> None:
    layout = make_replay_layout(rounds=3, steps=5, n=4, m=2)
    log = RawLog.in_memory(layout)
    for name in layout:
        getattr(log, name)[...] = 1
        others = [other for other in layout if other != name]
        assert all(not getattr(log, other).any() for other in others), name
        getattr(log, name)[...] = 0


def test_discard_removes_log_and_layout(tmp_path: Path) -> None:
    path = tmp_path / "cell.raw"
    RawLog.create(path, make_replay_layout(1, 2, 3, 3))
    delete_log_and_layout(path)
    assert list(tmp_path.iterdir()) == []

"""Ctrl-C: heard once where it must be, held back where a process is not ready for it."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from dpbench.bench.workers.interrupts import (
    block_sigint,
    block_terminal_signals,
    delay_signals,
    first_signal_only,
    forget_interrupts,
)

# Ctrl-C goes to all processes of a group.
pytestmark = pytest.mark.alone


@pytest.fixture(autouse=True)
def listens() -> Iterator[None]:
    """Ctrl-C is heard here and in processes started here, even where a shell that runs the tests in
    the background has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_only_the_first_press_is_heard() -> None:
    presses = 0
    with first_signal_only():
        for _ in range(3):
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                presses += 1
    assert presses == 1
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_who_listens_already_goes_on_listening() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        with first_signal_only():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(heard) == 2
    found: list[object] = []

    def elsewhere() -> None:
        with first_signal_only():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert found == [before]


def test_a_press_that_waits_is_heard_afterwards() -> None:
    reached = False
    with pytest.raises(KeyboardInterrupt), block_sigint():
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        reached = True
    assert reached


CHILD = """
import os, signal
from dpbench.bench.workers.interrupts import forget_interrupts
os.kill(os.getpid(), signal.SIGINT)
print("loaded")
forget_interrupts()
try:
    os.kill(os.getpid(), signal.SIGINT)
    signal.pause()
except KeyboardInterrupt:
    print("interrupted")
"""


def test_a_process_started_so_drops_what_came_before_it_was_ready() -> None:
    with block_sigint():
        process = subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True)
    said, _ = process.communicate(timeout=60)
    assert (said.split(), process.returncode) == (["loaded", "interrupted"], 0)


def test_a_process_that_holds_nothing_back_is_left_alone() -> None:
    handler = signal.getsignal(signal.SIGINT)
    forget_interrupts()
    assert signal.getsignal(signal.SIGINT) is handler
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_signals_wait_for_what_must_be_whole() -> None:
    reached = []
    with pytest.raises(KeyboardInterrupt):
        with delay_signals():
            for _ in range(2):
                signal.raise_signal(signal.SIGINT)
            reached.append("end")
        reached.append("behind it")
    assert reached == ["end"]
    with pytest.raises(ZeroDivisionError):
        try:
            _ = 1 / 0
        finally:
            with delay_signals():
                signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_a_terminal_sends_does_not_reach_some_processes() -> None:
    words = "import os, signal; [os.kill(os.getpid(), n) for n in (signal.SIGINT, signal.SIGHUP)]"
    with block_terminal_signals():
        process = subprocess.Popen([sys.executable, "-c", words])
    assert process.wait() == 0
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


STARTED_HALF_WAY = """
import os, signal, tempfile, time
from multiprocessing import reduction
from pathlib import Path
from dpbench.bench.workers.child import Child, start_forkserver
from dpbench.bench.workers.interrupts import first_signal_only
send = reduction.sendfds
def interrupted(*request):
    send(*request)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.1)
context = start_forkserver()
with tempfile.TemporaryDirectory() as folder:
    Child(context, time.sleep, (0.0,), Path(folder), "first", limit_s=None).process.join()
    reduction.sendfds = interrupted
    try:
        with first_signal_only():
            Child(context, time.sleep, (600.0,), Path(folder), "second", limit_s=None)
    except KeyboardInterrupt:
        time.sleep(0.5)
        print("interrupted")
"""


def test_a_signal_while_a_process_starts_leaves_no_traceback() -> None:
    command = [sys.executable, "-c", STARTED_HALF_WAY]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


HUNG_UP = """
import os, signal, time
from multiprocessing import resource_tracker
from dpbench.bench.workers.interrupts import start_resource_tracker
start_resource_tracker()
os.kill(resource_tracker._resource_tracker._pid, signal.SIGHUP)
time.sleep(0.3)
print(resource_tracker._resource_tracker._check_alive())
"""


def test_a_closed_terminal_does_not_end_the_resource_tracker() -> None:
    command = [sys.executable, "-c", HUNG_UP]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert (done.stdout, done.stderr) == ("True\n", "")

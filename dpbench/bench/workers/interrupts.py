"""Handling of Ctrl-C, SIGTERM and SIGHUP: the first ends the program, repeats do no harm."""

import math
import multiprocessing.resource_tracker
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a program: a person's, a scheduler's, a closed terminal's."""
QUIET_S = 5.0
"""Time after the first signal in which further ones are ignored [s], for what it saves and removes.
Later ones are heard again, in case the first came to nothing."""


class Interruption:
    """A signal that ended the program: `signal` is its number, 0 for none."""

    def __init__(self) -> None:
        self.signal = 0
        self._heard_s = -math.inf

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt at an ending signal, unless it follows another one closely."""
        if time.monotonic() - self._heard_s < QUIET_S:
            return
        self.signal, self._heard_s = number, time.monotonic()
        raise KeyboardInterrupt


@contextmanager
def first_signal_only(*, for_good: bool = False) -> Iterator[Interruption]:
    """Raise KeyboardInterrupt at the first ending signal in the block; ignore quick repeats.

    Repeats, by a person or a program that passes them on, must not interrupt what is being saved.
    Nothing changes outside the main thread, or for signals that are handled or ignored already.

    for_good : the program ends with the block; signals after the first stay ignored.
    """
    interruption = Interruption()
    defaults = (signal.SIG_DFL, signal.default_int_handler)
    in_main_thread = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in ENDING if in_main_thread}
    ours = {number: handler for number, handler in handlers.items() if handler in defaults}
    for number in ours:
        signal.signal(number, interruption.handle)
    try:
        yield interruption
    finally:
        for number, handler in ours.items():
            ends = for_good and interruption.signal
            signal.signal(number, signal.SIG_IGN if ends else handler)


@contextmanager
def block_sigint(*others: signal.Signals) -> Iterator[None]:
    """Delay Ctrl-C and `others` to the end of the block, also in processes started in it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *others})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def forget_interrupts() -> None:
    """Drop a delayed Ctrl-C of this process, and react to Ctrl-C from now on."""
    if signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ()):
        return
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGINT, heard)


@contextmanager
def delay_signals() -> Iterator[None]:
    """Delay Ctrl-C, SIGTERM and SIGHUP to the block's end; an exception that ends it drops them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in ENDING}
    heard: list[int] = []
    for number, handler in before.items():
        if callable(handler):
            signal.signal(number, lambda number, frame: heard.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, handler)
        if heard and sys.exception() is None:
            signal.raise_signal(heard[0])


@contextmanager
def block_terminal_signals() -> Iterator[None]:
    """Block Ctrl-C and SIGHUP in what is started in the block: one process handles them for all."""
    start_resource_tracker()
    with block_sigint(signal.SIGHUP):
        yield


def start_resource_tracker() -> None:
    """Start Python's process that removes shared memory, out of reach of SIGHUP; once.

    It ignores other ending signals. Killed, it would be started again with a warning. As it lets
    Ctrl-C through while it starts, it must not first be started where that is blocked.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        multiprocessing.resource_tracker.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

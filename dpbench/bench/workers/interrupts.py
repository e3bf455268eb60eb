"""Ctrl-C, SIGTERM and SIGHUP: the first is heard, and more of them do no harm."""

from __future__ import annotations

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
"""How long signals are not heard after the first: for what it saves and removes. Later ones are
heard again, in case the first came to nothing."""


class Interruption:
    """What has ended, or will end, a program from outside.

    Attributes
    ----------
    signal : the number of the last that was heard; 0 for none.
    """

    def __init__(self) -> None:
        self.signal = 0
        self._heard_s = -math.inf

    def hear(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if time.monotonic() - self._heard_s < QUIET_S:
            return
        self.signal, self._heard_s = number, time.monotonic()
        raise KeyboardInterrupt


@contextmanager
def first_signal_only(*, for_good: bool = False) -> Iterator[Interruption]:
    """The first signal that ends a program is a KeyboardInterrupt; those soon after it do nothing.

    A person presses Ctrl-C twice, and a program that runs this one may pass on what the terminal
    sent already: what the first one saves must not be lost by the second. Nothing changes outside
    the main thread, or where somebody else listens to a signal already or ignores it.

    Parameters
    ----------
    for_good : the program ends with the block; none is heard after one was.
    """
    interruption = Interruption()
    defaults = (signal.SIG_DFL, signal.default_int_handler)
    in_main_thread = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in ENDING if in_main_thread}
    ours = {number: handler for number, handler in handlers.items() if handler in defaults}
    for number in ours:
        signal.signal(number, interruption.hear)
    try:
        yield interruption
    finally:
        for number, handler in ours.items():
            ends = for_good and interruption.signal
            signal.signal(number, signal.SIG_IGN if ends else handler)


@contextmanager
def sigint_blocked() -> Iterator[None]:
    """Ctrl-C is heard at the end of the block; processes started in it hold it back as well."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def forget_interrupts() -> None:
    """In a process that was started so: drop what was held back, and listen from now on."""
    if signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ()):
        return
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGINT, heard)


@contextmanager
def signals_wait() -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP are heard at the end of the block: what is half begun or half
    ended there cannot be undone. Where an exception already ends the program they are not heard
    again. Nothing changes outside the main thread, nor where nobody listens to them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.getsignal(number) for number in numbers}
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
def terminal_signals_blocked() -> Iterator[None]:
    """Threads and processes started in the block never hear Ctrl-C, nor that their terminal is
    gone: a terminal sends both to all processes of a program, and one of them answers for all."""
    # It would let them through again while it starts its own process, and does nothing later.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

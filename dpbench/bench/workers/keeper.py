"""Importing this module puts a keeper above the process that imports it.

The fork server imports it before all else and splits: the child becomes the template that workers
are forked from (`template.py`), the parent its keeper, which

- adopts the orphans of workers, for `orphans.end_orphans` to end,
- continues a stopped template,
- ends all below it, and itself, when the template or the main program ends.

It sleeps in between and ignores signals of a terminal. If it is killed, the kernel kills the
template, and thereby the workers.
"""

import os
import select
import signal

from dpbench.bench.workers import orphans
from dpbench.bench.workers.orphans import adopt_orphans, end_children, end_with_parent

_IGNORED = (signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)


def _split_keeper() -> None:
    """Fork this process: the child returns as fork server, the parent watches it until its end."""
    main, keeper = os.getppid(), os.getpid()
    adopt_orphans()
    template = os.fork()
    if template == 0:
        end_with_parent(keeper)
        orphans.template, orphans.keeper = os.getpid(), keeper
        return
    try:
        _watch_forkserver(template, main)
        end_children()
    finally:
        os._exit(0)


def _watch_forkserver(template: int, main: int) -> None:
    """Wait until the fork server or the main program has ended."""
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)
    # The template's socket must refuse a connection when it is dead.
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    heard, hears = os.pipe()
    os.set_blocking(heard, False)
    os.set_blocking(hears, False)
    signal.set_wakeup_fd(hears, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    try:
        program = os.pidfd_open(main)
    except OSError:
        return
    poll = select.poll()
    poll.register(heard, select.POLLIN)
    poll.register(program, select.POLLIN)
    while os.getppid() == main and _reap_children(template):
        if program in dict(poll.poll()):
            return
        os.read(heard, 4096)


def _reap_children(template: int) -> bool:
    """Reap ended child processes; return False when the fork server has ended."""
    while True:
        try:
            state = os.waitid(os.P_ALL, 0, os.WEXITED | os.WSTOPPED | os.WNOHANG)
        except ChildProcessError:
            return False
        if state is None:
            return True
        if state.si_pid != template:
            continue
        if state.si_code != os.CLD_STOPPED:
            return False
        orphans.signal_process(template, signal.SIGCONT)


_split_keeper()

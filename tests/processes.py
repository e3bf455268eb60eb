"""Questions of tests about other processes."""

import psutil


def is_running(pid: int) -> bool:
    """Return whether a process exists and is no zombie.

    One question to the system: a process may end between two.
    """
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False

"""What tests ask of other processes."""

import psutil


def is_running(pid: int) -> bool:
    """Whether there is such a process, and it is not dead.

    One question to the system: a process may end between two.
    """
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False

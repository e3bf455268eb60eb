"""What tests ask of other processes."""

import psutil


def is_running(pid: int) -> bool:
    """Whether there is such a process, and it is not dead."""
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False

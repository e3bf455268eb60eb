"""The library in a notebook: runs in this process, and result folders."""

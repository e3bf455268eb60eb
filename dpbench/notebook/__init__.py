"""The library's door: runs in this process and result folders, as a notebook shows them."""

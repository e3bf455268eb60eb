"""One solver in one process: closed loop, replay, and what stands between it and the clock."""

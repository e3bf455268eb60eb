"""Step times of replays compared: ranks, ratios, growth, work and precision, routes."""

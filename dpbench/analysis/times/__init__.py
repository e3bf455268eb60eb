"""Step times of replays: ratios, growth, work and precision, routes; what disturbed them."""

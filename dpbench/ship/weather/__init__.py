"""Wind, waves, current, squalls, and the random streams behind them."""

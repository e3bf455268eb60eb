"""What the referee, the clock and the ship say of a run: rules, columns, rows."""

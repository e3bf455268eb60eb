"""Topics of ships that steer thrusters: what they hold, what a loss costs, what to conclude."""

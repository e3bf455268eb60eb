"""DP capability level 1 of DNV-ST-0111: mean loads on a hull, and what thrusters have left."""

"""DP capability level 1: the largest wind that thrusters hold, and the QPs at that edge."""

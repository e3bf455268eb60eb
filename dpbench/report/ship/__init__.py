"""The ship in words: station keeping, conditions, controller, thrust left, capability."""

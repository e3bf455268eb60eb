"""The tables of vessel and scenario files: keys, units and bounds."""

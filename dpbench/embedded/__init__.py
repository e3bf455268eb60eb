"""Cost of a solver's C on an embedded core: cross-compile, emulate, count instructions."""

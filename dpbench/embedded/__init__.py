"""What a solver costs as C on an embedded core: cross-compile, emulate, count instructions."""

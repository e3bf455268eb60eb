"""The types all packages share (QP, step, sequence, solution) and the referee."""

"""The language all rooms speak (QP, step, sequence, solution) and the referee."""

"""HPIPM through its own interface: dense, and by stages."""

from dpbench.solvers.libraries.hpipm.dense import NATIVE as DENSE
from dpbench.solvers.libraries.hpipm.ocp import NATIVE as OCP

__all__ = ["DENSE", "OCP"]

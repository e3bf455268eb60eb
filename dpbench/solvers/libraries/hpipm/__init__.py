"""HPIPM through its own interface: dense, and by stages."""

from dpbench.solvers.libraries.hpipm.dense import ADAPTER as DENSE
from dpbench.solvers.libraries.hpipm.ocp import ADAPTER as OCP

__all__ = ["DENSE", "OCP"]

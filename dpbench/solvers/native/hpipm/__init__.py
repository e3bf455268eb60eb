"""HPIPM through its own interface: dense, and by stages."""

from dpbench.solvers.native.hpipm.dense import ADAPTER as DENSE
from dpbench.solvers.native.hpipm.ocp import ADAPTER as OCP

__all__ = ["DENSE", "OCP"]

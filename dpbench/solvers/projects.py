"""The facts about each solver's project, with the place where the project states them.

A cell without a source is not stated by the project, as far as is known here; nothing is inferred.
"""

from __future__ import annotations

from dpbench.solvers.record import Fact, Project


def _known(
    licence: tuple[str, str],
    language: tuple[str, str],
    *,
    c_code: tuple[str, str] | None = None,
    allocation_free: tuple[str, str] | None = None,
    single_precision: tuple[str, str] | None = None,
) -> Project:
    further = (
        Fact(*pair) if pair else Fact() for pair in (c_code, allocation_free, single_precision)
    )
    return Project(Fact(*licence), Fact(*language), *further)


_DPBENCH = _known(
    ("Apache-2.0", "dpbench, pyproject.toml"), ("Python, compiled by Numba", "dpbench, source")
)
_HPIPM = _known(
    ("BSD-2-Clause", "HPIPM source, head of each file"),
    ("C, on BLASFEO", "HPIPM reference guide, Introduction"),
    c_code=("it is C to embed", "HPIPM reference guide, Introduction"),
    allocation_free=(
        "yes, memory comes from the caller",
        "HPIPM source, *_memsize and *_create",
    ),
    single_precision=("yes, routines s_*", "HPIPM source, s_dense_qp_ipm"),
)
_PIQP = _known(
    ("BSD-2-Clause", "PIQP README, Features"),
    ("C++14, C interface", "PIQP README, Features and Interfaces"),
    allocation_free=("yes, updates and re-solves", "PIQP README, Features"),
)
_PROXQP = _known(
    ("BSD-2-Clause", "ProxSuite documentation, What is ProxSuite?"),
    ("C++14", "ProxSuite README, main features"),
)
_CVXOPT_LANGUAGE = "Python and C"

PROJECTS: dict[str, Project] = {
    "clarabel": _known(
        ("Apache-2.0", "Clarabel, metadata of its distribution"),
        ("Rust", "Clarabel, metadata of its distribution"),
        single_precision=("yes, generic in its float type", "Clarabel.rs source, algebra/floats"),
    ),
    "cvxopt": _known(
        ("GPL-3.0-or-later", "CVXOPT, Copyright and license"),
        (_CVXOPT_LANGUAGE, "CVXOPT, metadata of its distribution"),
    ),
    "daqp": _known(
        ("MIT", "DAQP, metadata of its distribution"),
        ("C, library-free", "DAQP README"),
        c_code=("yes, renders a workspace", "DAQP source, codegen"),
        allocation_free=("yes, after setup", "DAQP Python interface, docstring of Model"),
        single_precision=("yes, DAQP_SINGLE_PRECISION", "DAQP source, include/types.h"),
    ),
    "ecos": _known(
        ("GPL-3.0", "ECOS, metadata of its distribution"),
        ("C", "ECOS README"),
    ),
    "highs": _known(
        ("MIT", "HiGHS, metadata of its distribution"),
        ("C++, C interface", "HiGHS documentation, front page"),
    ),
    "hildreth": _DPBENCH,
    "hpipm": _HPIPM,
    "hpipm_ocp": _HPIPM,
    "jaxopt": _known(("Apache-2.0", "JAXopt README"), ("Python on JAX", "JAXopt README")),
    "kvxopt": _known(
        ("GPL-3.0-or-later", "KVXOPT, metadata of its distribution"),
        (_CVXOPT_LANGUAGE, "KVXOPT, metadata of its distribution"),
    ),
    "osqp": _known(
        ("Apache-2.0", "OSQP, metadata of its distribution"),
        ("C, library-free", "OSQP web site, Features"),
        c_code=("yes, generates code for a problem", "OSQP web site, Features: Embeddable"),
        allocation_free=("yes, generated code", "OSQP web site, Features: no memory manager"),
        single_precision=("yes, OSQP_USE_FLOAT", "OSQP source, osqp_api_types.h"),
    ),
    "paper_active_set": _DPBENCH,
    "piqp": _PIQP,
    "piqp_multistage": _PIQP,
    "piqp_sparse": _PIQP,
    "proxqp": _PROXQP,
    "proxqp_sparse": _PROXQP,
    "pyqpmad": _known(
        ("BSD-3-Clause", "pyqpmad, LICENSE of its distribution"),
        ("C++, header-only on Eigen", "qpmad README"),
        allocation_free=("yes, after reserve", "pyqpmad README, Control Loop Example"),
    ),
    "qoco": _known(
        ("BSD-3-Clause", "QOCO README, License"),
        ("C", "QOCO documentation"),
        c_code=("yes, by QOCOGEN", "QOCOGEN README"),
        allocation_free=("yes, generated code", "QOCOGEN README: static memory allocation only"),
    ),
    "qpalm": _known(
        ("LGPL-3.0-or-later", "QPALM, metadata of its distribution"),
        ("C", "QPALM README, Supported platforms"),
    ),
    "qpax": _known(("MIT", "qpax README"), ("Python on JAX", "qpax README")),
    "qpoases": _known(
        ("LGPL-2.1-or-later", "qpOASES source, head of each file"),
        ("C++", "qpOASES manual, Introduction"),
        single_precision=("yes, __USE_SINGLE_PRECISION__", "qpOASES source, Constants.hpp"),
    ),
    "qtqp": _known(("Apache-2.0", "QTQP, metadata of its distribution"), ("Python", "QTQP README")),
    "quadprog": _known(
        ("GPL-2.0-or-later", "quadprog, metadata of its distribution"),
        ("C, from Fortran", "quadprog, its source"),
    ),
    "scs": _known(
        ("MIT", "SCS, metadata of its distribution"),
        ("C", "SCS documentation, front page"),
        single_precision=("yes, a flag of its build", "SCS source, scs.mk"),
    ),
    "sip": _known(
        ("MIT", "SIP, metadata of its distribution"),
        ("C++", "SIP QP README"),
        allocation_free=("yes, with Workspace::mem_assign", "SIP QP README"),
    ),
    "unconstrained_clipped": _DPBENCH,
}

"""How to cite: BibTeX of the paper whose method is run, and of the dpbench that ran it."""

from __future__ import annotations

from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.revision import revision_text

PAPER = """@misc{xia_dp_mpc,
  author = {Xia, Guoqing and Liu, Ju and Pang, Chengcheng and Xue, Jingjing},
  title = {Constrained Model Predictive Control Design for Dynamic Positioning of a Supply Ship},
  howpublished = {Conference paper, College of Automation, Harbin Engineering University},
}"""
"""A copy of the paper names neither the conference nor the year, so neither is said."""


def software(results: Results) -> str:
    """The dpbench that made a run: its version and commit, and the year of the run."""
    version = f"Software, version {results.suite.get('harness_version', '')}"
    return f"""@misc{{dpbench,
  author = {{{{The dpbench authors}}}},
  title = {{dpbench: benchmark of QP solvers inside the model predictive controller of a dynamically
    positioned ship}},
  year = {{{results.suite.get("started_utc", "")[:4]}}},
  howpublished = {{{", ".join(filter(None, (version, revision_text(results.suite))))}}},
}}"""

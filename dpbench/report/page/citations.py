"""BibTeX entries of dpbench and of the paper whose method it runs."""

from dpbench.bench.record.machine import describe_revisions
from dpbench.bench.record.result_folder import Results

PAPER_CITATION = """@misc{xia_dp_mpc,
  author = {Xia, Guoqing and Liu, Ju and Pang, Chengcheng and Xue, Jingjing},
  title = {Constrained Model Predictive Control Design for Dynamic Positioning of a Supply Ship},
  howpublished = {Conference paper, College of Automation, Harbin Engineering University},
  note = {The copy that dpbench follows names neither the year nor the conference},
}"""


def format_citations(results: Results) -> str:
    """Return BibTeX entries of the dpbench version that made the results, and of the paper."""
    return f"{format_software_citation(results)}\n\n{PAPER_CITATION}"


def format_software_citation(results: Results) -> str:
    """Return a BibTeX entry of the dpbench version that made the results."""
    version = f"Software, version {results.suite.get('harness_version', '')}"
    return f"""@misc{{dpbench,
  author = {{{{The dpbench authors}}}},
  title = {{dpbench: benchmark of {{QP}} solvers inside the model predictive controller of a
    dynamically positioned ship}},
  year = {{{results.suite.get("started_utc", "")[:4]}}},
  howpublished = {{{", ".join(filter(None, (version, describe_revisions(results.suite))))}}},
}}"""

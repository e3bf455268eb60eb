"""Descriptions of the two folders of a comparison: code, machine, load and options."""

from dpbench.analysis.compare.pairs import Pairs
from dpbench.analysis.records.machine import select_timed_replays, sum_disturbances
from dpbench.analysis.records.records import Records
from dpbench.bench.record.machine import describe_version
from dpbench.report.commands_text import describe_machine_states


def describe_folder(path: str, view: Records) -> str:
    """Return a text on a result folder: version and commit of dpbench, processor, other load."""
    wording = f"{path}, {describe_version(view.suite)}, "
    wording += f"{view.machine.get('cpu_model', 'an unnamed CPU')}"
    timed = select_timed_replays(view)
    is_known = sum_disturbances(timed).seconds > 0
    return f"{wording}, {describe_machine_states(timed)}" if is_known else wording


def describe_code_difference(a: Records, b: Records) -> str:
    """Return a note on two folders that different code of dpbench has made; "" for none.

    The code is that of the versions and commits in both `suite.json`. Files that differ from their
    commit may differ between two runs of one commit, too.
    """
    versions = [view.suite.get("harness_version", "") for view in (a, b)]
    revisions = [view.suite.get("revisions", []) for view in (a, b)]
    commits = [{one["commit"] for one in own} for own in revisions]
    has_changes = not all(one["clean"] for own in revisions for one in own)
    if all(commits) and commits[0] != commits[1]:
        made = "made by different commits of dpbench"
    elif versions[0] != versions[1]:
        made = "made by different versions of dpbench"
    elif has_changes:
        made = "made by dpbench with uncommitted changes"
    else:
        return ""
    return f"{made}: differences may come from dpbench"


def describe_changed_options(pairs: Pairs) -> list[str]:
    """Return lines on options of custom settings that changed under the same name."""
    changed = [pair for pair in pairs.pairs if pair.changed_options_text]
    return list(
        dict.fromkeys(
            f"options changed: {pair.a.solver} {pair.a.settings}: {pair.changed_options_text}"
            for pair in changed
        )
    )

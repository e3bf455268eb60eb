"""Errors of a person: one line, long lists cut, and the same behind a process boundary."""

import pickle

import pytest

from dpbench.errors import (
    InputError,
    SituationError,
    SolverUnavailableError,
    find_nearest_names,
    format_allowed_names,
    format_key_path,
)
from dpbench.solvers import table
from dpbench.solvers.table import (
    Availability,
    require_any_solver_available,
    require_solver_available,
)

NAMES = ("calm", "rough", "squall", "swell", "turn", "turning", "waves")


def test_a_short_list_is_given_whole() -> None:
    """Six names in their own order, more with the nearest first; a single name is no list."""
    assert format_allowed_names("tern", ["turn"]) == "turn"
    assert (
        format_allowed_names("tern", NAMES[1:], listing="list_scenarios()")
        == "one of rough, squall, swell, turn, turning, waves"
    )
    nearest_first = "one of turn, turning, waves, calm, rough, squall, swell"
    assert format_allowed_names("tern", NAMES) == nearest_first


@pytest.mark.parametrize(
    ("names", "listing", "rest"),
    [
        ((*NAMES, *map(str, range(10))), "", "… 14 more"),
        (NAMES, "list_scenarios()", "… 4 more: `list_scenarios()`"),
    ],
)
def test_a_long_list_is_cut_to_the_nearest_three(
    names: tuple[str, ...], listing: str, rest: str
) -> None:
    """Seven names, or 17 that nothing lists; the nearest first, then how many more there are."""
    *near, last = format_allowed_names("tern", names, listing=listing).split(", ")
    assert near[:2] == ["turn", "turning"] and near[2] in names
    assert last == rest


def test_a_name_in_capitals_is_near_the_same_in_small_letters() -> None:
    """Else "DAQP" has no letter in common with "daqp"."""
    assert find_nearest_names("TURN", NAMES)[0] == "turn"
    assert find_nearest_names("tern", ["TURN", *NAMES[:3]], likeness=0.6) == ["TURN"]


def test_a_long_list_is_cut_for_a_name_like_no_other() -> None:
    """Three names all the same, also for a text of a megabyte, at once."""
    assert "… 4 more" in format_allowed_names("§" * 1_000_000, NAMES, listing="list_scenarios()")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (InputError("a.toml", "key", 3, "0 to 1"), "a.toml: key: found 3; allowed: 0 to 1"),
        (
            InputError("a.toml", "", "No such file or directory", "a file"),
            "a.toml: no such file or directory; required: a file",
        ),
        (
            InputError("a.toml", "", "Permission denied", "a readable file"),
            "a.toml: permission denied; required: a readable file",
        ),
        (SituationError("--against", "add\n --for SOLVER"), "--against: add --for SOLVER"),
    ],
)
def test_an_error_is_the_same_from_another_process(error: InputError, text: str) -> None:
    """One line, of the same class, after pickling."""
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), type(again)) == (text, type(error)) and str(error) == text


@pytest.mark.parametrize(
    ("reason", "text"),
    [
        (
            "importing osqp failed: no libm",
            "importing osqp failed: no libm; run `pip install osqp`",
        ),
        ("not installed: pip install osqp", "not installed: pip install osqp"),
    ],
)
def test_a_missing_solver_is_named_with_its_remedy(
    reason: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command that installs it, once."""
    monkeypatch.setattr(
        table, "find_solver_availability", lambda name: Availability(False, "", reason)
    )
    with pytest.raises(SolverUnavailableError, match=f"^solver osqp: {text}$"):
        require_solver_available("osqp")


def test_solvers_are_missing_only_if_none_can_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reason is given once."""
    reasons = {"hpipm": "no casadi", "hpipm_ocp": "no casadi", "qpax": "no qpax", "osqp": ""}
    monkeypatch.setattr(
        table,
        "find_solver_availability",
        lambda name: Availability(not reasons[name], reason=reasons[name]),
    )
    require_any_solver_available([])
    require_any_solver_available(["qpax", "osqp"])
    with pytest.raises(SolverUnavailableError) as error:
        require_any_solver_available(["hpipm", "hpipm_ocp", "qpax"])
    assert str(error.value) == (
        "solvers hpipm, hpipm_ocp, qpax: no casadi; run `pip install casadi`; no qpax; "
        "run `pip install qpax`"
    )


def test_a_path_of_keys_reads_as_in_its_file() -> None:
    """Entries are counted from 1; JSON has no double brackets."""
    assert format_key_path([]) == ""
    assert format_key_path(["faults", 1], is_table=True) == "[[faults]] number 2"
    assert format_key_path(["closed_loop", 0]) == "closed_loop, entry 1"
    deep = ["environment", "squalls", 2, "force", "peak_kN", 0]
    assert format_key_path(deep) == "[[environment.squalls]] number 3, key force.peak_kN, entry 1"
    assert format_key_path(deep, is_toml=False) == (
        "environment.squalls, entry 3, key force.peak_kN, entry 1"
    )

"""Custom settings: text, grids, names, and back."""

import pytest

from dpbench.errors import InputError, ResultsError
from dpbench.solvers.own_settings import (
    decode_options_from_json,
    encode_options_as_json,
    expand_choice_over_option_grid,
    expand_option_grid,
    format_options_as_toml,
    parse_options_of_choice,
)


def test_a_choice_is_a_solver_with_options_as_in_toml() -> None:
    assert parse_options_of_choice("osqp") == {}
    assert parse_options_of_choice("osqp[rho=1.6, eps_abs=1e-5]") == {"rho": 1.6, "eps_abs": 1e-5}
    assert parse_options_of_choice('hpipm[mode="ROBUST"]') == {"mode": "ROBUST"}
    assert parse_options_of_choice("sip[termination.max_iter=9]") == {
        "termination": {"max_iter": 9}
    }


def test_a_grid_is_a_choice_for_each_of_its_points() -> None:
    assert expand_choice_over_option_grid("osqp") == ["osqp"]
    assert expand_choice_over_option_grid("osqp[rho=[0.1,1],eps_abs=[1e-5,1e-10]]") == [
        "osqp[eps_abs=1e-5,rho=0.1]",
        "osqp[eps_abs=1e-10,rho=0.1]",
        "osqp[eps_abs=1e-5,rho=1]",
        "osqp[eps_abs=1e-10,rho=1]",
    ]


def test_a_grid_reaches_into_a_group_of_options() -> None:
    points = expand_option_grid({"termination": {"max_iter": [1, 2], "tol": 1e-3}}, "x")
    assert points == [
        {"termination": {"max_iter": 1, "tol": 1e-3}},
        {"termination": {"max_iter": 2, "tol": 1e-3}},
    ]
    assert format_options_as_toml(points[1]) == "termination.max_iter=2,termination.tol=0.001"


def test_options_are_the_same_text_in_any_order() -> None:
    """The text is part of the identity of a run."""
    assert encode_options_as_json({"b": 1, "a": "é"}) == encode_options_as_json({"a": "é", "b": 1})
    assert decode_options_from_json(encode_options_as_json({"a": "é", "b": True})) == {
        "a": "é",
        "b": True,
    }
    assert encode_options_as_json({}) == "" and decode_options_from_json("") == {}


@pytest.mark.parametrize(
    "choice", ["osqp[", "osqp[]", "osqp[rho]", "osqp[rho=1", "osqp[rho=1]x", "osqp[rho=1,rho=2]"]
)
def test_what_is_no_choice_is_refused_in_one_line(choice: str) -> None:
    with pytest.raises(
        InputError, match=r"^solver osqp: found .*allowed: names with TOML values"
    ) as e:
        expand_choice_over_option_grid(choice)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("text", ["rho=fast", "alpha=1.5,rho = fast", "rho=[fast]"])
def test_a_text_without_quotes_is_named_with_its_option(text: str) -> None:
    with pytest.raises(InputError) as refused:
        expand_choice_over_option_grid(f"osqp[{text}]")
    allowed = 'a number, true, false, or text in quotes, as in rho="fast"'
    assert str(refused.value) == f"solver osqp: rho: found fast; allowed: {allowed}"


@pytest.mark.parametrize(
    "value",
    ["nan", "inf", "[]", "[[1]]", "1979-05-27", "[1,nan]", f"{2**63}", '"' + 201 * "x" + '"'],
)
def test_an_option_is_a_finite_number_or_a_short_text(value: str) -> None:
    with pytest.raises(InputError, match=r"solver osqp: rho: found .*a finite number, text"):
        expand_choice_over_option_grid(f"osqp[rho={value}]")


def test_a_grid_that_nobody_can_run_is_refused() -> None:
    numbers = {key: list(range(11)) for key in "abc"}
    with pytest.raises(InputError, match="x: c: found a grid of 1331 points; allowed: at most"):
        expand_option_grid(numbers, "x")


@pytest.mark.parametrize("text", ["[1]", "{", "1", '{"a":}'])
def test_a_damaged_table_of_runs_is_named(text: str) -> None:
    with pytest.raises(ResultsError, match=r"runs\.parquet: options"):
        decode_options_from_json(text)

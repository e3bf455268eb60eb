"""Horizons as text: "N_p/N_c", e.g. 30/5."""

import re

Horizons = tuple[int, int]
"""N_p and N_c."""


def parse_horizons(text: str) -> Horizons:
    """Parse horizons "N_p/N_c", e.g. "30/5", to two integers; ValueError if malformed."""
    match = re.fullmatch(r"([0-9]{1,4})/([0-9]{1,4})", text)
    N_p, N_c = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= N_c <= N_p:
        raise ValueError("N_p/N_c with N_c from 1 to N_p, e.g. 30/5")
    return N_p, N_c


def check_distinct_horizons(texts: list[str]) -> list[str]:
    """Return `texts` unchanged; ValueError if a pair of horizons is malformed or repeated."""
    seen: set[Horizons] = set()
    for text in texts:
        pair = parse_horizons(text)
        if pair in seen:
            raise ValueError(f"each pair of horizons once, {text} is there twice")
        seen.add(pair)
    return texts

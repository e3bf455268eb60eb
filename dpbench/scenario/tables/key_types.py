"""Types of the keys in problem files: numbers with bounds, vectors, matrices, horizons."""

import re
from typing import Annotated

from pydantic import Field

# Bounds far beyond any ship, so that a slip of the keyboard is an error and not an overflow.
Number = Annotated[float, Field(ge=-1e15, le=1e15)]
Positive = Annotated[float, Field(gt=0, le=1e15)]
Length = Annotated[float, Field(ge=1e-3, le=1e6)]
NotNegative = Annotated[float, Field(ge=0, le=1e15)]
Seconds = Annotated[float, Field(ge=1e-4, le=1e6)]
Degrees = Annotated[float, Field(ge=-36000, le=36000)]
Speed = Annotated[float, Field(ge=-100, le=100)]
TurnRate = Annotated[float, Field(ge=-90, le=90)]
Percent = Annotated[float, Field(gt=-100, le=1e4)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0, le=1_000_000)]
Horizon = Annotated[int, Field(ge=1, le=1000)]
PolygonSides = Annotated[
    int,
    Field(
        ge=4,
        le=128,
        multiple_of=2,
        json_schema_extra={"allowed": "an even number, 4 to 128"},
    ),
]
Two = Annotated[list[Number], Field(min_length=2, max_length=2)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
ThreeByThree = Annotated[list[Three], Field(min_length=3, max_length=3)]
ThreePositive = Annotated[list[Positive], Field(min_length=3, max_length=3)]
ThreeNotNegative = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
ThreeLosses = Annotated[
    list[Annotated[float, Field(ge=0, le=100)]], Field(min_length=3, max_length=3)
]
ThreeShares = Annotated[list[Share], Field(min_length=3, max_length=3)]

Horizons = tuple[int, int]  # N_p and N_c


def parse_horizons(text: str) -> Horizons:
    """Return the two integers of horizons "N_p/N_c", e.g. "30/5"; ValueError if malformed."""
    match = re.fullmatch(r"([0-9]{1,4})/([0-9]{1,4})", text)
    N_p, N_c = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= N_c <= N_p:
        raise ValueError("N_p/N_c with N_c from 1 to N_p, such as 30/5")
    return N_p, N_c


def require_distinct_horizon_texts(texts: list[str]) -> list[str]:
    """Return `texts` unchanged; ValueError if a pair of horizons is malformed or repeated."""
    seen: set[Horizons] = set()
    for text in texts:
        pair = parse_horizons(text)
        if pair in seen:
            raise ValueError(f"each pair of horizons once; {text} is given twice")
        seen.add(pair)
    return texts

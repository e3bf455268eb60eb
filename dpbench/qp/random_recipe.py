"""Recipes of random parametric QPs: families, and the data a sequence is made from."""

from dataclasses import dataclass

from dpbench.errors import InputError
from dpbench.qp.program import has_equal_blocks

MARGIN = 0.25  # By how much the limits of an infeasible step contradict each other
NEAR = 2.0**-26  # Distance to a limit that is missed by less than most tolerances
LARGEST = (120, 300)  # Most variables and rows; with more, sums would be rounded


@dataclass(frozen=True)
class Family:
    """Family of random QPs, defined by the properties that make them hard.

    cond : condition of P where a recipe names none; semidefinite : P has less than full rank.
    touching : rows and bounds met with a zero multiplier, as a share of n.
    twins : share of rows that are written twice; equal, free, one_sided : shares of rows.
    open_bounds : share of bounds that are infinite.
    infeasible : every third step has no feasible point.
    """

    shows: str
    cond: float = 1e2
    semidefinite: bool = False
    touching: float = 0.0
    twins: float = 0.0
    equal: float = 0.0
    free: float = 0.0
    one_sided: float = 0.0
    open_bounds: float = 0.0
    infeasible: bool = False


FAMILIES: dict[str, Family] = {
    "plain": Family("every limit that is met has a multiplier"),
    "degenerate": Family(
        "more limits met than there are variables, rows written twice", touching=1.0, twins=0.3
    ),
    "weakly_active": Family("limits met with a zero multiplier, or missed by 1.5e-8", touching=0.3),
    "equal": Family("rows with l = u among others", equal=0.3),
    "free": Family("rows without any limit, or with one", free=0.4, one_sided=0.3),
    "infinite_bounds": Family(
        "half of the bounds infinite, rows with one limit", one_sided=0.4, open_bounds=0.5
    ),
    "no_rows": Family("bounds alone, m = 0"),
    "semidefinite": Family("P of less than full rank, the optimum unique", semidefinite=True),
    "ill_conditioned": Family("cond(P) = 1e8", cond=1e8),
    "infeasible_steps": Family(
        "every third step has no feasible point, by a margin of 0.25", twins=0.2, infeasible=True
    ),
}


@dataclass(frozen=True)
class RandomRecipe:
    """Parameters from which a random QP sequence is generated.

    family : a name of `FAMILIES`.
    n, m : variables and rows, at most `LARGEST`; seed : of everything random.
    steps : length of the sequence; block : as in `QuadraticProgram`.
    cond : condition of P, 0 for that of the family.
    """

    family: str
    n: int
    m: int
    seed: int
    steps: int = 24
    block: int = 0
    cond: float = 0.0

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise _make_recipe_input_error(
                "family", repr(self.family), f"one of {', '.join(FAMILIES)}"
            )
        if not 2 <= self.n <= LARGEST[0]:
            raise _make_recipe_input_error("n", self.n, f"2 to {LARGEST[0]}")
        rows = {"degenerate": self.n, "no_rows": 0, "plain": 0, "semidefinite": 0}
        least = rows.get(self.family, 2)
        most = LARGEST[1] if self.family != "no_rows" else 0
        if not least <= self.m <= most:
            allowed = f"{least} to {most} for {self.family} with n = {self.n}"
            raise _make_recipe_input_error("m", self.m, allowed)
        if self.seed < 0 or self.steps < 1:
            raise _make_recipe_input_error(
                "seed, steps", (self.seed, self.steps), "0 or more, 1 or more"
            )
        if self.block < 0 or not has_equal_blocks(self.n, self.m, self.block):
            allowed = f"0, or a divisor of n={self.n} into moves that share m={self.m} rows alike"
            raise _make_recipe_input_error("block", self.block, allowed)
        if self.cond != 0.0 and not 1.0 <= self.cond <= 1e8:
            raise _make_recipe_input_error(
                "cond", self.cond, "1 to 1e8, or 0 for that of the family"
            )

    @property
    def sequence_name(self) -> str:
        """Unique name of the recipe, e.g. `plain-n12-m30-s1`."""
        usual = {"steps": 24, "block": 0, "cond": 0.0}
        values = {key: getattr(self, key) for key in usual}
        extra = "".join(f"-{key}{value:g}" for key, value in values.items() if value != usual[key])
        return f"{self.family}-n{self.n}-m{self.m}-s{self.seed}{extra}"


def _make_recipe_input_error(key: str, found: object, allowed: str) -> InputError:
    """Return the InputError for a parameter that a recipe does not allow."""
    return InputError("random recipe", key, found, allowed)

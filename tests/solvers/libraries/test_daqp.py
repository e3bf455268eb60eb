"""The cold start of DAQP: one call of the library for each QP."""

import numpy as np
import pytest

from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import Sequence


@pytest.mark.parametrize("settings", ["default", "high"])
def test_a_cold_start_takes_the_iterations_of_an_emptied_active_set(sequence, settings):
    """One call for each QP takes the steps that a kept `Model` without active set takes."""
    cold, emptied = (
        Sequence(sequence.base, sequence.steps).answers(
            open_workspace("daqp", route="native", policy=policy, settings=settings)
        )
        for policy in ("fresh", "reuse")
    )
    assert [one.iterations for one in cold] == [one.iterations for one in emptied]
    for one, other in zip(cold, emptied, strict=True):
        np.testing.assert_allclose(one.z, other.z, rtol=0, atol=1e-9)
        np.testing.assert_allclose(one.y, other.y, rtol=0, atol=1e-7)


def test_a_setting_reaches_the_single_call(sequence):
    """With one iteration allowed, a QP that needs more is not solved."""
    (answer,) = Sequence(sequence.base, sequence.steps[:1]).answers(
        open_workspace("daqp", route="native", policy="fresh", settings={"iter_limit": 1})
    )
    assert answer.status.name == "MAX_ITERATIONS"

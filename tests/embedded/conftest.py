"""Fixtures of the tests that compile and emulate."""

import pytest

from dpbench.embedded.toolchain import has_extra


@pytest.fixture(scope="session")
def embedded_extra() -> None:
    """Skip a test where the extra `embedded` is not installed."""
    if not has_extra():
        pytest.skip("the extra `embedded` is not installed")

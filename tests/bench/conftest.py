"""Plug-ins of one test are unknown to the others."""

import pytest

from dpbench.solvers import plugins


@pytest.fixture(autouse=True)
def no_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "_LOADED", {})

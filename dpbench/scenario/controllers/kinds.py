"""The controllers by their key in a scenario file, `controller.kind`."""

from __future__ import annotations

from collections.abc import Callable

from dpbench.scenario.controllers.cascade import CascadeController
from dpbench.scenario.controllers.controller import Controller
from dpbench.scenario.controllers.forces import ForceController
from dpbench.scenario.controllers.specification import ControllerSpec
from dpbench.scenario.controllers.thrusters import ThrusterController

CONTROLLERS: dict[str, Callable[[ControllerSpec], Controller]] = {
    "forces": ForceController.of,
    "thrusters": ThrusterController.of,
    "cascade": CascadeController.of,
}
"""Each raises InputError for a vessel or faults that do not fit it."""

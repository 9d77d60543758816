"""Controllers: the reference law and its rivals, all with the interface `predict`."""

from vergence.controllers.controller import CONTROLLERS, Controller, make_controller

__all__ = ["CONTROLLERS", "Controller", "make_controller"]

"""The reference law and its rivals, all with one `predict`."""

from vergence.controllers.controller import CONTROLLERS, Controller, make_controller

__all__ = ["CONTROLLERS", "Controller", "make_controller"]

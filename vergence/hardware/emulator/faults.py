"""The faults of an emulated head over time: active and scheduled ones, and effects on servos."""

import logging
from collections.abc import Iterable
from math import inf
from typing import Final

from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.emulator.fault import Fault, Place
from vergence.hardware.emulator.servo import ENCODER_ERROR, LOAD_ERROR, EmulatedServo

_LOG: Final = logging.getLogger(__name__)
_FAULT_REGISTERS: Final = {
    "voltage": (table.PRESENT_INPUT_VOLTAGE, 10.0),
    "temperature": (table.PRESENT_TEMPERATURE, 1.0),
    "load": (table.PRESENT_LOAD, 10.0),
}
"""Register, and register units per unit of a fault's value, by the fault's name."""


class ActiveFaults:
    """The active faults, and those that a script will begin.

    Args:
        servos: the servos of the head.

    Attributes:
        unplugged: True once the line's cable has been pulled.
    """

    def __init__(self, servos: Iterable[EmulatedServo]) -> None:
        self.unplugged = False
        self._servos = tuple(servos)
        self._healthy = [
            {name: servo.get(register) for name, (register, _) in _FAULT_REGISTERS.items()}
            for servo in self._servos
        ]
        self._on: list[tuple[float, Fault]] = []  # with their end times, s
        self._script: list[Fault] = []
        self._script_s: float | None = None  # None until the script begins

    @property
    def due_s(self) -> float:
        """Time at which the next fault begins or ends by itself, s; inf for none."""
        ends = min((end_s for end_s, _ in self._on), default=inf)
        if self._script_s is None or not self._script:
            return ends
        return min(ends, self._script_s + self._script[0].at_s)

    def active_on(self, place: Place) -> list[Fault]:
        """Active faults of one kind of part, in the order in which they began."""
        return [fault for _, fault in self._on if fault.place == place]

    def schedule(self, script: Iterable[Fault]) -> None:
        """Set the script: faults that begin by themselves."""
        self._script = sorted(script, key=lambda fault: fault.at_s)

    def start_script(self, now_s: float) -> None:
        """Start the script's time; a second call does nothing."""
        if self._script_s is None:
            self._script_s = now_s

    def begin(self, fault: Fault, now_s: float) -> None:
        """Begin a fault."""
        _tell(fault, "begins")
        if fault.what == "unplug":
            self.unplugged = True
            return
        if fault.what in ("overload", "reboot"):
            for servo in self._servos:
                if servo.id in fault.ids:
                    servo.set_hardware_errors(
                        LOAD_ERROR
                    ) if fault.what == "overload" else servo.reboot()
            return
        self._on.append((now_s + fault.for_s, fault))
        self._apply()

    def advance_to(self, now_s: float) -> None:
        """Begin and end the faults that are due; the servos have to be advanced to this time."""
        for end_s, fault in self._on:
            if end_s <= now_s:
                _tell(fault, "ends")
        self._on = [one for one in self._on if one[0] > now_s]
        self._apply()
        while self._script_s is not None and self._script:
            if self._script_s + self._script[0].at_s > now_s:
                break
            self.begin(self._script.pop(0), now_s)

    def clear(self) -> None:
        """End all active faults; those that happen once, and a pulled cable, stay."""
        for _, fault in self._on:
            _tell(fault, "ends")
        self._on.clear()
        self._apply()

    def _apply(self) -> None:
        for servo, healthy in zip(self._servos, self._healthy, strict=True):
            own = {fault.what: fault for fault in self.active_on("servo") if servo.id in fault.ids}
            servo.silent = "silent" in own
            servo.stuck = "stuck" in own
            servo.blind = "blind" in own or "blind-told" in own
            servo.inverted = "inverted" in own
            servo.goal_scale = -1.0 if "wrong-way" in own else _value(own, "goal-scale")
            servo.speed_scale = _value(own, "speed-scale")
            servo.freeze("frozen" in own or servo.blind)
            if "blind-told" in own:
                servo.set_hardware_errors(ENCODER_ERROR)
            for name, (register, units) in _FAULT_REGISTERS.items():
                measured = round(own[name].value * units) if name in own else healthy[name]
                servo.set(register, measured)


def _value(faults: dict[str, Fault], name: str) -> float:
    return faults[name].value if name in faults else 1.0


def _tell(fault: Fault, what: str) -> None:
    whose = fault.eye if fault.place == "camera" else ", ".join(map(str, fault.ids))
    _LOG.info("fault %s: %s of %s %s", what, fault.what, fault.place, whose)

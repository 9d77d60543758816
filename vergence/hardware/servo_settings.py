"""Registers of servos that shape motion or protect it: set for a run, and put back after it.

Profiles shape a commanded velocity before the servo follows it, and a limit of the PWM takes its
torque. A servo switches its torque off only at those faults that SHUTDOWN lists, which from the
factory does not have a broken encoder: its motor runs away. Registers of the RAM keep the new value
until the power goes off; those of the EEPROM are put back. They are locked while torque is on, so a
servo that holds torque lets go for a moment, and only at rest.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from vergence.errors import Finding, HardwareError, ServoRefusalError
from vergence.hardware.config import ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.control_table import Register
from vergence.hardware.dynamixel.repeated import read_register, write_register

_LOG: Final = logging.getLogger(__name__)
_NEEDED_SHUTDOWN: Final = 1 << 3 | 1 << 5
"""Bits that SHUTDOWN needs: motor encoder and overload (physical: Dynamixel X series)."""
_REST_READS: Final = 500
"""Reads of the speed before a joint counts as one that does not come to rest; they take half a
second at least (chosen)."""
_REST_TICKS: Final = 1
"""Greatest speed at rest, units of PRESENT_VELOCITY: its resolution (chosen)."""


class ServoSettings:
    """The registers that a run has changed.

    Args:
        bus: the line of the servos.

    """

    def __init__(self, bus: Bus) -> None:
        self._changed: dict[str, list[str]] = {}  # names of servos by what was changed
        self._bus = bus
        self._kept: dict[int, dict[Register, int]] = {}  # first values in the EEPROM by id

    @property
    def findings(self) -> list[Finding]:
        """A warning for each change of a register, or what could not be changed."""
        return [
            Finding(part=f"servos: {', '.join(names)}", problem=problem, warning=True)
            for problem, names in self._changed.items()
        ]

    def set_up(self, servo: ServoConfig) -> None:
        """Set a servo's registers. The servo is in velocity mode, its goal is zero.

        Raises:
            HardwareError: it does not answer or refuses, or its joint does not come to rest.
        """
        shutdown = read_register(self._bus, servo.id, table.SHUTDOWN)
        wanted = ((table.PWM_LIMIT, table.FULL_PWM), (table.SHUTDOWN, shutdown | _NEEDED_SHUTDOWN))
        changes = [
            (register, old, value)
            for register, value in wanted
            if (old := read_register(self._bus, servo.id, register)) != value
        ]
        if changes:
            with _unlocked(self._bus, servo):
                for register, old, value in changes:
                    self._change(servo, register, old, value)
        self.set_motion(servo)

    def set_motion(self, servo: ServoConfig) -> None:
        """Set those registers of the RAM that change how a servo follows its commands.

        Raises:
            HardwareError: it does not answer.
        """
        for register, value in (
            (table.PROFILE_ACCELERATION, 0),
            (table.PROFILE_VELOCITY, 0),
            (table.GOAL_PWM, read_register(self._bus, servo.id, table.PWM_LIMIT)),
        ):
            old = read_register(self._bus, servo.id, register)
            if old != value:
                self._change(servo, register, old, value)

    def _change(self, servo: ServoConfig, register: Register, old: int, value: int) -> None:
        locked = register.address < table.EEPROM_END
        until = "until the end" if locked else "until its power is off"
        done = f"which is set to {value} {until}"
        try:
            write_register(self._bus, servo.id, register, value)
        except ServoRefusalError:
            done = f"which the servo refuses to change to {value}"
        else:
            if locked:
                self._kept.setdefault(servo.id, {})[register] = old
        problem = f"expected {value} in {register.name}, got {old}, {done}"
        _LOG.info("%s: %s", servo.name, problem)
        self._changed.setdefault(problem, []).append(servo.name)

    def put_back(self, servo: ServoConfig) -> str:
        """Put back what was in a servo's EEPROM; return the problem, empty if there is none."""
        kept = self._kept.pop(servo.id, {})
        if not kept:
            return ""
        try:
            with _unlocked(self._bus, servo):
                for register, value in kept.items():
                    write_register(self._bus, servo.id, register, value)
        except HardwareError as error:
            first = ", ".join(f"{register.name} {value}" for register, value in kept.items())
            text = str(error).removeprefix(f"servos: {servo.name}: ")
            return f"servos: {servo.name}: expected to put back {first} at the end, got {text}"
        return ""


@contextmanager
def _unlocked(bus: Bus, servo: ServoConfig) -> Iterator[None]:
    """Take a servo's torque while the block runs, if it has any and its joint rests."""
    if not read_register(bus, servo.id, table.TORQUE_ENABLE):
        yield
        return
    for _ in range(_REST_READS):
        if abs(read_register(bus, servo.id, table.PRESENT_VELOCITY)) <= _REST_TICKS:
            break
    else:
        raise HardwareError(
            f"servos: {servo.name}: expected a joint at rest, to change the servo's EEPROM, got "
            "one that moves; cure: hold the head, and switch its power off and on"
        )
    try:
        write_register(bus, servo.id, table.TORQUE_ENABLE, 0)
        yield
    finally:
        with suppress(HardwareError):  # it is zero already, and the torque matters more
            write_register(bus, servo.id, table.GOAL_VELOCITY, 0)
        write_register(bus, servo.id, table.TORQUE_ENABLE, 1)

"""Checks of one servo's registers before it gets torque, each with its cure."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from vergence.errors import Finding
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.servo_angles import ServoAngles
from vergence.hardware.servo_memory import ServoMemory, describe_fault_bits, model_name

WATCHDOG_FIRMWARE: Final = 38
"""First firmware with BUS_WATCHDOG (physical: X series, and MX with Protocol 2.0)."""
_UNRELIABLE_WATCHDOG_MODELS: Final = frozenset((1190, 1200, 1210, 1220, 1230, 1240))
"""MODEL_NUMBER of servos whose watchdog may fail (physical: XL330 and XC330)."""
_UNRELIABLE_WATCHDOG_FIRMWARE: Final = 51
"""Latest firmware of these with reports of a watchdog that does not stop the motor (physical:
forum.robotis.com/t/4814)."""
_START_TEMPERATURE_MARGIN_K: Final = 10
"""Least margin to the temperature limit at the start, K (chosen)."""
_JOINT_LIMIT_TOLERANCE_RAD: Final = 0.02
"""Tolerance of a joint's limits, rad, for sagging and backlash of the gears (chosen)."""
WIZARD: Final = "with ROBOTIS's Dynamixel Wizard"
_POWER_CYCLE_CURE: Final = "switch its power off and on"
_DRIVE_MODES: Final = {
    0: "reverse direction, which `sign` in the configuration is for",
    2: "profiles by time",
    3: "torque on by any goal",
}
"""Texts of the bits of DRIVE_MODE."""


def check_registers(
    config: HardwareConfig, servo: ServoConfig, memory: ServoMemory, *, check_joint_in_limits: bool
) -> Iterator[Finding]:
    """Find all problems in a servo's registers.

    Args:
        config: the robot.
        servo: the servo, of a supported model.
        memory: its registers.
        check_joint_in_limits: True to check that its joint is within its limits.
    """
    asked = _ServoRegisters(config, servo, memory)
    for check in _CHECKS:
        if check_joint_in_limits or check is not _posture:
            yield from check(asked)


def servo_finding(servo: ServoConfig, problem: str, cure: str, *, warning: bool = False) -> Finding:
    """Make a finding of a servo."""
    return Finding(part=f"servos: {servo.name}", problem=problem, cure=cure, warning=warning)


@dataclass(frozen=True)
class _ServoRegisters:
    """One servo and its registers."""

    config: HardwareConfig
    servo: ServoConfig
    memory: ServoMemory

    def get(self, register: table.Register) -> int:
        return self.memory.get(register)

    def finding(self, problem: str, cure: str, *, warning: bool = False) -> Finding:
        return servo_finding(self.servo, problem, cure, warning=warning)

    def expect(self, register: table.Register, value: int, reason: str = "") -> Iterator[Finding]:
        """Yield a finding if a register has another value."""
        got = self.get(register)
        if got != value:
            yield self.finding(
                f"expected {value} in {register.name}, got {got}{reason}",
                f"set it to {value} {WIZARD}",
            )


def _firmware(one: _ServoRegisters) -> Iterator[Finding]:
    model, firmware = one.get(table.MODEL_NUMBER), one.get(table.FIRMWARE_VERSION)
    if firmware < WATCHDOG_FIRMWARE:
        yield one.finding(
            f"expected firmware {WATCHDOG_FIRMWARE} or later, the first that stops the servo when "
            f"nobody speaks, got {firmware}",
            f"renew it {WIZARD}",
        )
    elif model in _UNRELIABLE_WATCHDOG_MODELS and firmware <= _UNRELIABLE_WATCHDOG_FIRMWARE:
        yield one.finding(
            f"expected firmware later than {_UNRELIABLE_WATCHDOG_FIRMWARE} of "
            f"{model_name(model)}, got "
            f"{firmware}, of which users report that its watchdog does not stop the motor",
            f"renew it {WIZARD}, or keep a switch of the power at hand",
            warning=True,
        )


def _return_level(one: _ServoRegisters) -> Iterator[Finding]:
    return one.expect(table.STATUS_RETURN_LEVEL, 2, ": it does not answer to writes")


def _protocol(one: _ServoRegisters) -> Iterator[Finding]:
    return one.expect(table.PROTOCOL_TYPE, 2)


def _baud_rate(one: _ServoRegisters) -> Iterator[Finding]:
    rate, number = one.config.bus.baud_rate, one.get(table.BAUD_RATE)
    known = number < len(table.BAUD_RATES)
    got = f"{table.BAUD_RATES[number]} baud" if known else f"the number {number}"
    if not known or table.BAUD_RATES[number] != rate:
        yield one.finding(
            f"expected {rate} baud, as in the configuration, got {got} in BAUD_RATE",
            f"set it {WIZARD}, or bus.baud_rate in the configuration",
        )


def _mode(one: _ServoRegisters) -> Iterator[Finding]:
    mode = one.get(table.OPERATING_MODE)
    if mode != table.VELOCITY_MODE and one.get(table.TORQUE_ENABLE):
        yield one.finding(
            f"expected velocity mode ({table.VELOCITY_MODE}) or no torque, got torque in mode "
            f"{mode}: to change the mode would drop the joint",
            f"hold the head, and {_POWER_CYCLE_CURE}",
        )


def _drive_mode(one: _ServoRegisters) -> Iterator[Finding]:
    mode = one.get(table.DRIVE_MODE)
    bits = [f"bit {bit}" for bit in range(8) if mode >> bit & 1]
    words = [_DRIVE_MODES[bit] for bit in _DRIVE_MODES if mode >> bit & 1]
    return one.expect(table.DRIVE_MODE, 0, f" ({', '.join(words or bits)})")


def _homing_offset(one: _ServoRegisters) -> Iterator[Finding]:
    return one.expect(table.HOMING_OFFSET, 0, " (`zero_ticks` in the configuration is for that)")


def _velocity_limit(one: _ServoRegisters) -> Iterator[Finding]:
    limit = one.get(table.VELOCITY_LIMIT)
    servo_rad_s = limit * table.TICK_RAD_S / one.servo.gear_ratio
    head_rad_s = float(one.config.head.actuation.velocity[one.servo.slot])
    # the limit is in whole units of the servo's speed
    if servo_rad_s + table.TICK_RAD_S / one.servo.gear_ratio < head_rad_s:
        yield one.finding(
            f"expected a VELOCITY_LIMIT of at least {head_rad_s:.3g} rad/s of the joint, as the "
            f"head's model has it, got {servo_rad_s:.3g} rad/s ({limit})",
            f"raise it {WIZARD}, or lower velocity_rad_s in the head file",
            warning=limit > 0,
        )


def _velocity_gains(one: _ServoRegisters) -> Iterator[Finding]:
    model = one.get(table.MODEL_NUMBER)
    known = table.factory_velocity_gains(model)
    got = one.get(table.VELOCITY_I_GAIN), one.get(table.VELOCITY_P_GAIN)
    if got not in known:
        expected = " or ".join(f"{i} and {p}" for i, p in known)
        yield one.finding(
            f"expected {expected} in VELOCITY_I_GAIN and VELOCITY_P_GAIN, as {model_name(model)} "
            f"has them from the factory, got {got[0]} and {got[1]}",
            "switch its power off and on, or measure how it follows: `vergence measure-delay`",
            warning=True,
        )


def _secondary_id(one: _ServoRegisters) -> Iterator[Finding]:
    id = one.get(table.SECONDARY_ID)
    if id >= table.NO_SECONDARY_ID or id == one.servo.id:
        return
    others = [servo.name for servo in one.config.servos if servo.id == id]
    obeys = f", so it obeys {others[0]} too, without an answer" if others else ""
    yield one.finding(
        f"expected 255 in SECONDARY_ID, for none, got {id}{obeys}",
        f"set it to 255 {WIZARD}",
        warning=not others,
    )


def _voltage(one: _ServoRegisters) -> Iterator[Finding]:
    least, most = one.get(table.MIN_VOLTAGE_LIMIT), one.get(table.MAX_VOLTAGE_LIMIT)
    got = one.get(table.PRESENT_INPUT_VOLTAGE)
    if not least <= got <= most:
        yield one.finding(
            f"expected {0.1 * least:.1f} to {0.1 * most:.1f} V, got {0.1 * got:.1f} V",
            f"a supply with the voltage of {model_name(one.get(table.MODEL_NUMBER))} that holds "
            "it under load",
        )


def _temperature(one: _ServoRegisters) -> Iterator[Finding]:
    below, got = (
        one.get(table.TEMPERATURE_LIMIT) - _START_TEMPERATURE_MARGIN_K,
        one.get(table.PRESENT_TEMPERATURE),
    )
    if got >= below:
        yield one.finding(f"expected below {below} C, got {got} C", "let it cool down")


def _faults(one: _ServoRegisters) -> Iterator[Finding]:
    errors = one.get(table.HARDWARE_ERROR_STATUS)
    if errors:
        yield one.finding(
            f"expected no latched fault, got one of {describe_fault_bits(errors)} (hardware error "
            f"status 0b{errors:08b})",
            f"remove the cause, then {_POWER_CYCLE_CURE}",
        )


def joint_angle_from_registers(
    config: HardwareConfig, servo: ServoConfig, memory: ServoMemory
) -> float:
    """Angle of a servo's joint from its registers, rad."""
    angles = ServoAngles((servo,), config.head)
    state = bytes(4) + table.PRESENT_POSITION.encode(memory.get(table.PRESENT_POSITION))
    angles.update({servo.id: state}, 0.0)
    return float(angles.angles[servo.slot])


def _posture(one: _ServoRegisters) -> Iterator[Finding]:
    servo, ticks = one.servo, one.get(table.PRESENT_POSITION)
    angle_rad = joint_angle_from_registers(one.config, servo, one.memory)
    if (
        not servo.lower_rad - _JOINT_LIMIT_TOLERANCE_RAD
        <= angle_rad
        <= servo.upper_rad + _JOINT_LIMIT_TOLERANCE_RAD
    ):
        yield one.finding(
            f"expected an angle of {servo.lower_rad:.3f} to {servo.upper_rad:.3f} rad, got "
            f"{angle_rad:.3f} rad (position {ticks})",
            "turn it by hand with torque off, or mend zero_ticks: `vergence jog`",
        )


_CHECKS: Final[tuple[Callable[[_ServoRegisters], Iterator[Finding]], ...]] = (
    _firmware,
    _return_level,
    _protocol,
    _baud_rate,
    _mode,
    _drive_mode,
    _homing_offset,
    _velocity_limit,
    _velocity_gains,
    _secondary_id,
    _voltage,
    _temperature,
    _faults,
    _posture,
)

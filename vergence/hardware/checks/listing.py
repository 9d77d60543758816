"""All checks of a robot as a list of parts, each with its description and its problems."""

from contextlib import suppress
from dataclasses import dataclass

from vergence.errors import ChecksFailedError, Finding, HardwareError
from vergence.hardware.camera_checks import camera_requests, check_cameras
from vergence.hardware.checks.line import open_bus
from vergence.hardware.checks.registers import joint_angle_from_registers
from vergence.hardware.checks.servos import check_servos
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.servo_memory import model_name, read_memory


@dataclass(frozen=True, kw_only=True)
class CheckedPart:
    """One part of a robot."""

    name: str
    """Name of the part, as in `Finding`."""
    description: str
    """Description of the part; empty if nothing is known."""
    findings: tuple[Finding, ...]
    """Faults and warnings of the part."""

    @property
    def ready(self) -> bool:
        """True if the robot may move with it."""
        return all(finding.warning for finding in self.findings)


def check_robot(config: HardwareConfig) -> list[CheckedPart]:
    """Check the line, each servo and each camera. Nothing is written to a servo.

    Args:
        config: the robot.

    Returns:
        The parts in this order.

    Raises:
        HardwareError: the line was lost during the checks.
    """
    if config.emulator_address:
        try:
            WorldClient(config.emulator_address).close()
        except HardwareError as error:
            return [_no_emulator(str(error))]
    there = {"bus": f"{config.bus.port} at {config.bus.baud_rate} baud"}
    for servo in config.servos:
        there[f"servos: {servo.name}"] = ""
    try:
        bus = open_bus(config.bus)
    except ChecksFailedError as error:
        findings = list(error.findings)
    else:
        try:
            findings = check_servos(config, bus)
            for servo in config.servos:
                with suppress(HardwareError):
                    there[f"servos: {servo.name}"] = _servo(config, servo, bus)
        finally:
            bus.close()
    states, found = check_cameras(camera_requests(config))
    findings += found
    for camera in config.cameras:
        there[camera.name] = ""
    for state in states:
        size = "" if state.size is None else f"{state.size[0]} x {state.size[1]}, "
        there[state.request.name] = f"{size}{state.rate_hz:.1f} images a second"
    for finding in findings:  # of several parts at once, such as all cameras
        there.setdefault(finding.part, "")
    return [
        CheckedPart(
            name=part,
            description=what,
            findings=tuple(one for one in findings if one.part == part),
        )
        for part, what in there.items()
    ]


def _no_emulator(problem: str) -> CheckedPart:
    finding = Finding(
        part="emulator",
        problem=problem.removeprefix("emulator: "),
        cure="start `vergence emulate --out` anew, which writes its port and streams of then",
    )
    return CheckedPart(name=finding.part, description="", findings=(finding,))


def _servo(config: HardwareConfig, servo: ServoConfig, bus: Bus) -> str:
    memory = read_memory(bus, servo.id)
    volts = 0.1 * memory.get(table.PRESENT_INPUT_VOLTAGE)
    celsius = memory.get(table.PRESENT_TEMPERATURE)
    angle = joint_angle_from_registers(config, servo, memory)
    name = model_name(memory.get(table.MODEL_NUMBER))
    return f"{name}, id {servo.id}, {volts:.1f} V, {celsius} C, at {angle:.3f} rad"

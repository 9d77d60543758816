"""All checks of a robot before it moves: its servos, its posture and its cameras."""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from vergence.errors import ChecksFailedError, Finding, HardwareError
from vergence.hardware.camera_checks import camera_requests, check_cameras
from vergence.hardware.config import HardwareConfig
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.servos import JointAngles, Servos

_JOINT_LIMIT_TOLERANCE_RAD: Final = 0.02
"""Tolerance of a joint's limits, rad, for sagging and backlash of the gears (chosen)."""


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


def raise_errors(findings: Iterable[Finding]) -> list[Finding]:
    """Raise an error if a finding is one; return the warnings otherwise.

    Raises:
        ChecksFailedError: a finding is an error; it holds the warnings too.
    """
    findings = list(findings)
    if not all(finding.warning for finding in findings):
        raise ChecksFailedError(findings)
    return findings


def check_servos(
    config: HardwareConfig, servos: Servos, *, check_joint_in_limits: bool = True
) -> list[Finding]:
    """Find all problems of open servos before they get torque. Nothing is written to them.

    Args:
        config: the robot.
        servos: its servos, open.
        check_joint_in_limits: True to check that joints are within their limits; False while
            zeros are being set.

    Raises:
        HardwareError: the line is gone.
    """
    findings = servos.check()
    if servos.stops_alone_after_s is None:
        findings.append(
            Finding(
                part="bus",
                problem="expected servos that stop by themselves when nobody speaks, got ones that "
                "nothing stops: if this process dies, they turn on",
                cure="keep a switch of their power at hand",
                warning=True,
            )
        )
    if check_joint_in_limits:
        findings += _posture(config, servos)
    return findings


def _posture(config: HardwareConfig, servos: Servos) -> list[Finding]:
    """Joints out of their limits, and a forbidden posture."""
    angles = JointAngles(config.servos, config.head)
    reading = servos.read()
    read = angles.update(reading)
    found = angles.angles.copy()
    findings = []
    for place, servo in enumerate(config.servos):
        angle_rad = float(found[servo.slot])
        if not read[place]:
            found[servo.slot] = float("nan")
            continue
        beyond_rad = max(servo.lower_rad - angle_rad, angle_rad - servo.upper_rad)
        if beyond_rad > _JOINT_LIMIT_TOLERANCE_RAD:
            position = servo.position_text(float(reading.angles[place]))
            findings.append(
                Finding(
                    part=f"servos: {servo.name}",
                    problem=f"expected an angle of {servo.lower_rad:.3f} to {servo.upper_rad:.3f} "
                    f"rad, got {angle_rad:.3f} rad (position {position})",
                    cure=f"turn it by hand with torque off, or mend {servo.zero_key}: "
                    "`vergence jog`",
                )
            )
    for posture in config.safety.forbidden:
        if posture.contains(found):
            problem = posture.refusal(found, config.slots)
            cure = "turn it out of there by hand with torque off"
            findings.append(Finding(part="safety", problem=problem, cure=cure))
    return findings


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
            problem = str(error).removeprefix("emulator: ")
            cure = "start `vergence emulate --out` anew, which writes its port and streams of then"
            finding = Finding(part="emulator", problem=problem, cure=cure)
            return [CheckedPart(name="emulator", description="", findings=(finding,))]
    there = {"bus": "", **{f"servos: {servo.name}": "" for servo in config.servos}}
    servos = config.make_servos(time.monotonic)
    try:
        servos.open()
    except ChecksFailedError as error:
        findings = list(error.findings)
        there |= servos.describe()
    else:
        try:
            findings = check_servos(config, servos)
            there |= servos.describe()
            angles = JointAngles(config.servos, config.head)
            for servo, known in zip(config.servos, angles.update(servos.read()), strict=True):
                if known:
                    told = there[f"servos: {servo.name}"]
                    at = f"at {angles.angles[servo.slot]:.3f} rad"
                    there[f"servos: {servo.name}"] = f"{told}, {at}" if told else at
        finally:
            servos.close()
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

"""Checks of the servos before any of them gets torque. They only read.

All problems are found at once, each with its cure, so that a robot can be repaired in one go.
"""

import logging
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from vergence.errors import ChecksFailedError, Finding, HardwareError
from vergence.hardware.checks.line import (
    check_exchange_fits_period,
    check_latency_timer,
    cycle_timeout_s,
    measure_exchange_s,
)
from vergence.hardware.checks.registers import (
    WATCHDOG_FIRMWARE,
    WIZARD,
    check_registers,
    joint_angle_from_registers,
    servo_finding,
)
from vergence.hardware.config import HardwareConfig, ServoConfig
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.repeated import REQUESTS, ping_again, read_register
from vergence.hardware.servo_memory import ServoMemory, read_memory
from vergence.models.parts import FloatArray

_LOG: Final = logging.getLogger(__name__)
_PROBED_IDS: Final = range(1, 21)
"""Ids to ping if a configured id does not answer, to help find a typing error (chosen)."""


def check_servos(
    config: HardwareConfig, bus: Bus, *, check_joint_in_limits: bool = True, sysfs: str = "/sys"
) -> list[Finding]:
    """Find all problems of the servos and their line. Nothing is written to a servo.

    The timeout of the line's answers in a control period is set by their measured time.

    Args:
        config: the robot.
        bus: its open line.
        check_joint_in_limits: True to check that joints are within their limits; False while zeros
            are being set.
        sysfs: mount point of sysfs.

    Raises:
        HardwareError: the line is gone.
    """
    findings = []
    models, damaged = {}, set()
    for servo in config.servos:
        before = bus.damaged_packets
        models[servo.name] = ping_again(bus, servo.id)
        if models[servo.name] is None and bus.damaged_packets - before >= REQUESTS:
            damaged.add(servo.id)
    missing = [servo for servo in config.servos if models[servo.name] is None]
    if len(missing) == len(config.servos):
        findings.append(_nobody(config, bus, bool(damaged)))
    else:
        findings += [_equal_ids(servo) for servo in missing if servo.id in damaged]
        findings += _missing(config, bus, [one for one in missing if one.id not in damaged])
    delays: dict[str, int] = {}
    angles = np.full(7, np.nan)
    for servo in config.servos:
        model = models[servo.name]
        if model is None:
            continue
        if model not in table.MODELS:
            findings.append(_unknown(servo, model))
            continue
        _LOG.info("%s: %s with the id %d", servo.name, table.MODELS[model], servo.id)
        memory = _memory(servo, bus)
        if isinstance(memory, Finding):
            findings.append(memory)
            continue
        if memory.get(table.FIRMWARE_VERSION) >= WATCHDOG_FIRMWARE:
            findings += _watchdog(servo, bus)
        delays[servo.name] = memory.get(table.RETURN_DELAY_TIME)
        findings += check_registers(
            config, servo, memory, check_joint_in_limits=check_joint_in_limits
        )
        angles[servo.slot] = joint_angle_from_registers(config, servo, memory)
    if check_joint_in_limits:
        findings += _forbidden(config, angles)
    exchange_s = measure_exchange_s(bus, [one.id for one in config.servos if one.name in delays])
    bus.cycle_timeout_s = cycle_timeout_s(exchange_s, config.head.timing.period_s)
    findings += check_exchange_fits_period(config, delays, sysfs, exchange_s)
    latency = check_latency_timer(config.bus.port, sysfs)
    return findings if latency is None else [*findings, latency]


def raise_errors(findings: Iterable[Finding]) -> list[Finding]:
    """Raise an error if a finding is one; return the warnings otherwise.

    Raises:
        ChecksFailedError: a finding is an error; it holds the warnings too.
    """
    findings = list(findings)
    if not all(finding.warning for finding in findings):
        raise ChecksFailedError(findings)
    return findings


def _memory(servo: ServoConfig, bus: Bus) -> ServoMemory | Finding:
    """Read a servo's registers, or find out why that fails."""
    for _ in range(2):  # on a noisy line all answers of a read may be damaged once, but not twice
        before = bus.damaged_packets
        try:
            return read_memory(bus, servo.id)
        except HardwareError as error:
            if bus.damaged_packets - before < REQUESTS:
                return _silent(servo, str(error))
    return _equal_ids(servo)


def _nobody(config: HardwareConfig, bus: Bus, damaged: bool) -> Finding:
    ids = ", ".join(str(servo.id) for servo in config.servos)
    expected = f"expected the ids {ids} to answer on {bus.port} at {config.bus.baud_rate} baud"
    if damaged:
        return Finding(
            part="bus",
            problem=f"{expected}, got damaged answers",
            cure="give each servo an id of its own, and shorten or mend the data cable; "
            f"`vergence scan-bus {bus.port}` shows one servo's id if it is alone on the line",
        )
    return Finding(
        part="bus",
        problem=f"{expected}, got no answer from any",
        cure="switch on the servos' power and check data and ground cables; "
        f"`vergence scan-bus {bus.port}` finds servos with other ids or baud rates",
    )


def _missing(config: HardwareConfig, bus: Bus, missing: list[ServoConfig]) -> Iterator[Finding]:
    if not missing:
        return
    absent = {servo.id for servo in missing}
    asked = sorted({*_PROBED_IDS, *(servo.id for servo in config.servos)} - absent)
    there = ", ".join(str(one) for one in asked if bus.ping(one) is not None)
    for servo in missing:
        yield servo_finding(
            servo,
            f"expected a servo with the id {servo.id} on {bus.port} at {config.bus.baud_rate} "
            f"baud, got no answer; there are the ids {there}",
            "check its cable, and its id and baud rate with "
            f"`vergence scan-bus {bus.port}`; ids that are equal hide each other",
        )


def _forbidden(config: HardwareConfig, angles: FloatArray) -> Iterator[Finding]:
    for one in config.safety.forbidden:
        if one.contains(angles):
            yield Finding(
                part="safety",
                problem=one.refusal(angles, config.slots),
                cure="turn it out of there by hand with torque off",
            )


def _equal_ids(servo: ServoConfig) -> Finding:
    return servo_finding(
        servo,
        f"expected one servo with the id {servo.id}, got two or more, whose answers damage each "
        "other",
        f"give each servo an id of its own {WIZARD}, while it is alone on the line; if no other "
        "has this id, mend the data cable",
    )


def _watchdog(servo: ServoConfig, bus: Bus) -> Iterator[Finding]:
    try:
        read_register(bus, servo.id, table.BUS_WATCHDOG)
    except HardwareError as error:
        yield servo_finding(
            servo,
            f"expected a BUS_WATCHDOG, which stops the servo when nobody speaks, got {error}",
            f"renew its firmware {WIZARD}",
        )


def _unknown(servo: ServoConfig, model: int) -> Finding:
    return servo_finding(
        servo,
        f"expected a Dynamixel of the X series, or MX with Protocol 2.0, got the model number "
        f"{model} of id {servo.id}",
        "another servo, or its firmware for Protocol 2.0",
    )


def _silent(servo: ServoConfig, problem: str) -> Finding:
    return servo_finding(
        servo,
        f"{problem}, though it answers to a ping",
        f"set its STATUS_RETURN_LEVEL to 2 {WIZARD}, or mend its cable",
    )

"""Checks of Dynamixel servos and their line before any of them gets torque. They only read.

All problems are found at once, each with its cure, so that a robot can be repaired in one go. In
each control period a sync write of n goals and a sync read of n states take, with the return
delays of the answers and the latency of the adapter, the time

    t = 10 bits (28 + 6 n + 19 n) / rate + sum of the return delays + latency.

The latency of most adapters can only be measured, by exchanges with the servos.
"""

import logging
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import IntEnum
from glob import glob
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from vergence.errors import ChecksFailedError, Finding, HardwareError
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import CYCLE_TIMEOUT_S, REQUESTS, Bus
from vergence.hardware.dynamixel.control_table import (
    MOTION_SPAN,
    PRESENT_VALUES_SPAN,
    ServoMemory,
    describe_fault_bits,
    model_name,
)
from vergence.hardware.servos import ServoConfig
from vergence.models.head import HeadModel

_CURRENT_LIMIT: Final = table.Register("CURRENT_LIMIT", 38, 2)
_MODELS_WITHOUT_CURRENT: Final = frozenset((30, 1060, 1070, 1080, 1090, 1160))
"""MODEL_NUMBER of servos without a current sensor (physical: ROBOTIS's MX-28, XL430, XC430, 2XL430,
2XC430)."""
_FULL_LOAD_READING: Final = 1000
"""PRESENT_LOAD at the greatest torque (physical: register unit 0.1 %)."""
_UNKNOWN_FAULT: Final = 1 << 7
"""Bit for a fault that a servo has announced, but whose status could not be read (numerical)."""

WARM_K: Final = 10.0
"""Margin below the temperature limit at which a servo is warm, and gets no torque, K (chosen)."""
HOT_K: Final = 5.0
"""Margin below the temperature limit at which a servo has to rest without torque, K (chosen)."""
_VOLTAGE_WARNING_FRACTION: Final = 0.03
"""Distance to a voltage limit that gives a warning, as a fraction of the limit (chosen)."""
_HIGH_LOAD: Final = 0.8
"""Fraction of the full load that counts as high (chosen)."""
_FULL_LOAD_FRACTION: Final = 0.95
"""Fraction of the full load that counts as full (chosen)."""
_LOAD_READS: Final = 3
"""Consecutive reads at full load that stop the head, or at high load that give a warning; fewer may
be an acceleration (chosen)."""


class Level(IntEnum):
    """The judgement of a servo's health, from good to bad."""

    OK = 0
    WARN = 1
    STOP = 2


class Health(NamedTuple):
    """One reading of a servo."""

    temperature_c: float
    voltage_v: float
    load: float
    """Fraction of the greatest torque or current, -1 to 1; nan if unknown."""
    errors: int
    """Bits of HARDWARE_ERROR_STATUS."""


class HealthLimits(NamedTuple):
    """Limits stored in a servo's EEPROM."""

    max_temperature_c: float
    min_voltage_v: float
    max_voltage_v: float
    full_load_reading: float = np.nan
    """PRESENT_LOAD at full torque or at the current limit; nan if unknown."""


class HealthJudgement(NamedTuple):
    """Judgement of one reading."""

    level: Level
    text: str
    """Expected and actual value of each that is not ok; empty if all are."""
    is_hot: bool = False
    """True if its torque has to go off, as holding still heats it too."""


def limits_of(memory: ServoMemory, full_load_reading: float = np.nan) -> HealthLimits:
    """Limits among a servo's registers."""
    return HealthLimits(
        float(memory.get(table.TEMPERATURE_LIMIT)),
        0.1 * memory.get(table.MIN_VOLTAGE_LIMIT),
        0.1 * memory.get(table.MAX_VOLTAGE_LIMIT),
        full_load_reading,
    )


def read_limits(bus: Bus, id: int) -> HealthLimits:
    """Read a servo's limits; raise a `HardwareError` if it does not answer."""
    memory = bus.read_memory(id, ((0, 2), (31, 5)))
    full = float(_FULL_LOAD_READING)
    if memory.get(table.MODEL_NUMBER) not in _MODELS_WITHOUT_CURRENT:
        # models that lack the register refuse the read or return 0
        full = np.nan
        with suppress(HardwareError):
            full = float(bus.read(id, _CURRENT_LIMIT)) or np.nan
    return limits_of(memory, full)


def read_health(bus: Bus, limits: Mapping[int, HealthLimits]) -> dict[int, Health]:
    """Read the health of servos with one request, and faults that they announce."""
    found = {}
    for id, data in bus.sync_read(limits, *PRESENT_VALUES_SPAN).items():
        memory = ServoMemory({PRESENT_VALUES_SPAN[0]: data})
        errors = 0
        if id in bus.alerts:
            errors = _UNKNOWN_FAULT
            with suppress(HardwareError):
                errors = bus.read(id, table.HARDWARE_ERROR_STATUS, requests=1)
        found[id] = Health(
            float(memory.get(table.PRESENT_TEMPERATURE)),
            0.1 * memory.get(table.PRESENT_INPUT_VOLTAGE),
            memory.get(table.PRESENT_LOAD) / limits[id].full_load_reading,
            errors,
        )
    return found


def judge_temperature(limits: HealthLimits, temperature_c: float) -> tuple[Level, str]:
    """Judge a temperature against its limit; the text says what was expected."""
    limit_c = limits.max_temperature_c
    if temperature_c < limit_c - WARM_K:
        return Level.OK, ""
    level = Level.STOP if temperature_c >= limit_c - HOT_K else Level.WARN
    below_c = limit_c - (HOT_K if level == Level.STOP else WARM_K)
    return level, f"expected below {below_c:g} C, got {temperature_c:g} C"


def judge_voltage(limits: HealthLimits, voltage_v: float) -> tuple[Level, str]:
    """Judge a voltage against its limits; the text says what was expected."""
    least, most = limits.min_voltage_v, limits.max_voltage_v
    text = f"expected {least:.1f} to {most:.1f} V, got {voltage_v:.1f} V"
    # voltages come in steps of 0.1 V: allow half a step
    if not least - 0.05 < voltage_v < most + 0.05:
        return Level.STOP, text
    spare = _VOLTAGE_WARNING_FRACTION
    if least * (1.0 + spare) < voltage_v < most * (1.0 - spare):
        return Level.OK, ""
    return Level.WARN, text


class HealthWatch:
    """Judges one servo's readings by its limits."""

    def __init__(self, limits: HealthLimits) -> None:
        self.limits = limits
        self._full = self._high = 0

    def judge(self, health: Health) -> HealthJudgement:
        """Judge a reading; a load counts only after three readings in a row."""
        found = list(self._findings(health))
        level = max((one for one, _ in found), default=Level.OK)
        hot = health.temperature_c >= self.limits.max_temperature_c - HOT_K
        return HealthJudgement(level, "; ".join(text for _, text in found), hot)

    def _findings(self, health: Health) -> Iterator[tuple[Level, str]]:
        level, text = judge_temperature(self.limits, health.temperature_c)
        if level:
            goes = ", so its torque goes off" if level == Level.STOP else ""
            yield level, f"temperature: {text}{goes}"
        level, text = judge_voltage(self.limits, health.voltage_v)
        if level:
            yield level, f"voltage: {text}"
        share = abs(health.load)
        self._full = self._full + 1 if share >= _FULL_LOAD_FRACTION else 0
        self._high = self._high + 1 if share >= _HIGH_LOAD else 0  # not if it is unknown
        if self._full >= _LOAD_READS:
            most = f"{_FULL_LOAD_FRACTION:.0%}"
            yield Level.STOP, f"load: expected below {most}, got {share:.0%} at {_LOAD_READS} looks"
        elif self._high >= _LOAD_READS:
            yield Level.WARN, f"load: expected below {_HIGH_LOAD:.0%}, got {share:.0%}"
        if health.errors:
            yield Level.STOP, f"fault: {describe_fault_bits(health.errors)}"


_LOG: Final = logging.getLogger(__name__)
_PROBED_IDS: Final = range(1, 21)
"""Ids to ping if a configured id does not answer, to help find a typing error (chosen)."""
_RETURN_DELAY_UNIT_S: Final = 2e-6
"""Unit of RETURN_DELAY_TIME, s (physical: Dynamixel X series)."""
_PORTS: Final = ("/dev/serial/by-id/*", "/dev/ttyUSB*", "/dev/ttyACM*")
_FRAME_BYTES: Final = 14
"""Bytes of a sync instruction without its servos: header, id, length, instruction, address, length
of the data, CRC (physical: Protocol 2.0)."""
_GOAL_BYTES: Final = 5
"""Bytes of a sync write per servo: id and GOAL_VELOCITY (physical: Protocol 2.0)."""
_ANSWER_BYTES: Final = 11 + 8
"""Bytes of an answer: frame, velocity and position (physical: Protocol 2.0)."""
_MAX_EXCHANGE_FRACTION: Final = 0.6
"""Greatest exchange time as a fraction of the period; the rest is for computing and jitter
(chosen)."""
_EXCHANGES: Final = 20
"""Sync reads that are timed (chosen)."""
_COUNTED_EXCHANGE: Final = 15
"""Place of the exchange that counts among these, from the shortest on: adapters may poll, which
spreads their latency, while this machine holds up a few at times (chosen)."""
_TIMEOUT_RATIO: Final = 1.5
"""Timeout of the answers in a control period by the time of that exchange (chosen)."""
_MAX_TIMEOUT_FRACTION: Final = 0.75
"""Greatest such timeout as a fraction of the period: a silent servo must not cost more (chosen)."""
LATE_ANSWERS_CURE: Final = (
    "another adapter, or a latency timer of 1 ms of this one, or a lower control_rate_hz in the "
    "head file"
)
"""Cure of answers that come late while the robot runs."""
_DELAY_WARNING_FRACTION: Final = 0.1
"""Return delays above this fraction of a period give a warning (chosen)."""
_MIN_LATENCY_TIMER_MS: Final = 1
"""Least latency timer of FTDI adapters, ms; the factory default is 16 (physical: FTDI)."""
_WATCHDOG_FIRMWARE: Final = 38
"""First firmware with BUS_WATCHDOG (physical: X series, and MX with Protocol 2.0)."""
_UNRELIABLE_WATCHDOG_MODELS: Final = frozenset((1190, 1200, 1210, 1220, 1230, 1240))
"""MODEL_NUMBER of servos whose watchdog may fail (physical: XL330 and XC330)."""
_UNRELIABLE_WATCHDOG_FIRMWARE: Final = 51
"""Latest firmware of these with reports of a watchdog that does not stop the motor (physical:
forum.robotis.com/t/4814)."""
_WIZARD: Final = "with ROBOTIS's Dynamixel Wizard"
_POWER_CYCLE_CURE: Final = "switch its power off and on"
_DRIVE_MODES: Final = {
    0: "reverse direction, which `sign` in the configuration is for",
    2: "profiles by time",
    3: "torque on by any goal",
}
"""Texts of the bits of DRIVE_MODE."""


def open_bus(port: str, baud_rate: int) -> Bus:
    """Open the line of the servos."""
    if not os.path.exists(port):
        found = [one for pattern in _PORTS for one in sorted(glob(pattern))]
        problem = f"expected a serial port, got {port}: no such device"
        cure = "plug the adapter in, or name one of the ports that are there: " + (
            ", ".join(found) or "none"
        )
        raise ChecksFailedError([Finding(part="bus", problem=problem, cure=cure)])
    try:
        return Bus(port, baud_rate)
    except HardwareError as error:
        problem, cure = str(error), ""
        if "permission" in problem:
            cure = "sudo usermod -aG dialout $USER, then log out and in again"
        elif "another process" in problem:
            cure = f"end the other program; fuser -v {port} names it"
        raise ChecksFailedError([Finding(part="bus", problem=problem, cure=cure)]) from error


def check_latency_timer(port: str, sysfs: str = "/sys") -> Finding | None:
    """Check the latency timer of an FTDI adapter, on Linux; `sysfs` is its mount point."""
    name = os.path.basename(os.path.realpath(port))
    latency_ms = _latency_timer_ms(port, sysfs)
    if latency_ms <= _MIN_LATENCY_TIMER_MS:
        return None
    return Finding(
        part="bus",
        problem=f"expected a latency timer of {_MIN_LATENCY_TIMER_MS} ms of {name}, got "
        f"{latency_ms} ms, which every answer waits for",
        cure=f"echo {_MIN_LATENCY_TIMER_MS} | sudo tee "
        f"/sys/bus/usb-serial/devices/{name}/latency_timer",
        warning=True,
    )


def _latency_timer_ms(port: str, sysfs: str) -> int:
    """Latency timer of an FTDI adapter, ms; 0 for other ports and systems."""
    name = os.path.basename(os.path.realpath(port))
    path = Path(sysfs, "bus/usb-serial/devices", name, "latency_timer")
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0


def check_servos(
    servos: Sequence[ServoConfig], head: HeadModel, bus: Bus, sysfs: str = "/sys"
) -> list[Finding]:
    """Find all problems of the servos and their line. Nothing is written to a servo.

    The timeout of the line's answers in a control period is set by their measured time.

    Args:
        servos: the servos.
        head: the model of the head.
        bus: their open line.
        sysfs: mount point of sysfs.

    Raises:
        HardwareError: the line is gone.
    """
    findings: list[Finding] = []
    models, damaged = {}, set()
    for servo in servos:
        before = bus.damaged_packets
        models[servo.name] = bus.ping(servo.id, REQUESTS)
        if models[servo.name] is None and bus.damaged_packets - before >= REQUESTS:
            damaged.add(servo.id)
    missing = [servo for servo in servos if models[servo.name] is None]
    if len(missing) == len(servos):
        findings.append(_nobody(servos, bus, bool(damaged)))
    else:
        findings += [_equal_ids(servo) for servo in missing if servo.id in damaged]
        findings += _missing(servos, bus, [one for one in missing if one.id not in damaged])
    delays: dict[str, int] = {}
    for servo in servos:
        model = models[servo.name]
        if model is None:
            continue
        if model not in table.MODELS:
            problem = (
                "expected a Dynamixel of the X series, or MX with Protocol 2.0, got the model "
                f"number {model} of id {servo.id}"
            )
            findings.append(_of(servo, problem, "another servo, or its firmware for Protocol 2.0"))
            continue
        _LOG.info("%s: %s with the id %d", servo.name, table.MODELS[model], servo.id)
        memory = _memory(servo, bus)
        if isinstance(memory, Finding):
            findings.append(memory)
            continue
        if memory.get(table.FIRMWARE_VERSION) >= _WATCHDOG_FIRMWARE:
            findings += _watchdog(servo, bus)
        delays[servo.name] = memory.get(table.RETURN_DELAY_TIME)
        findings += _registers(servo, servos, head, bus.line.baud, memory)
    exchange_s = _measure_exchange_s(bus, [one.id for one in servos if one.name in delays])
    bus.cycle_timeout_s = cycle_timeout_s(exchange_s, head.timing.period_s)
    findings += check_exchange(bus, head, len(servos), delays, sysfs, exchange_s)
    latency = check_latency_timer(bus.port, sysfs)
    return findings if latency is None else [*findings, latency]


def _of(servo: ServoConfig, problem: str, cure: str, *, warning: bool = False) -> Finding:
    """A finding of a servo."""
    return Finding(part=f"servos: {servo.name}", problem=problem, cure=cure, warning=warning)


def _nobody(servos: Sequence[ServoConfig], bus: Bus, damaged: bool) -> Finding:
    ids = ", ".join(str(servo.id) for servo in servos)
    got = "damaged answers" if damaged else "no answer from any"
    cure = (
        "give each servo an id of its own, and shorten or mend the data cable; "
        f"`vergence scan-bus {bus.port}` shows one servo's id if it is alone on the line"
        if damaged
        else "switch on the servos' power and check data and ground cables; "
        f"`vergence scan-bus {bus.port}` finds servos with other ids or baud rates"
    )
    problem = f"expected the ids {ids} to answer on {bus.port} at {bus.line.baud} baud, got {got}"
    return Finding(part="bus", problem=problem, cure=cure)


def _missing(
    servos: Sequence[ServoConfig], bus: Bus, missing: list[ServoConfig]
) -> Iterator[Finding]:
    if not missing:
        return
    absent = {servo.id for servo in missing}
    asked = sorted({*_PROBED_IDS, *(servo.id for servo in servos)} - absent)
    there = ", ".join(str(one) for one in asked if bus.ping(one) is not None)
    for servo in missing:
        yield _of(
            servo,
            f"expected a servo with the id {servo.id} on {bus.port} at {bus.line.baud} "
            f"baud, got no answer; there are the ids {there}",
            "check its cable, and its id and baud rate with "
            f"`vergence scan-bus {bus.port}`; ids that are equal hide each other",
        )


def _equal_ids(servo: ServoConfig) -> Finding:
    return _of(
        servo,
        f"expected one servo with the id {servo.id}, got two or more, whose answers damage each "
        "other",
        f"give each servo an id of its own {_WIZARD}, while it is alone on the line; if no other "
        "has this id, mend the data cable",
    )


def _memory(servo: ServoConfig, bus: Bus) -> ServoMemory | Finding:
    """Read a servo's registers, or find out why that fails."""
    for _ in range(2):  # on a noisy line all answers of a read may be damaged once, but not twice
        before = bus.damaged_packets
        try:
            return bus.read_memory(servo.id)
        except HardwareError as error:
            if bus.damaged_packets - before < REQUESTS:
                return _of(
                    servo,
                    f"{error}, though it answers to a ping",
                    f"set its STATUS_RETURN_LEVEL to 2 {_WIZARD}, or mend its cable",
                )
    return _equal_ids(servo)


def _watchdog(servo: ServoConfig, bus: Bus) -> Iterator[Finding]:
    try:
        bus.read(servo.id, table.BUS_WATCHDOG)
    except HardwareError as error:
        yield _of(
            servo,
            f"expected a BUS_WATCHDOG, which stops the servo when nobody speaks, got {error}",
            f"renew its firmware {_WIZARD}",
        )


def _registers(
    servo: ServoConfig,
    servos: Sequence[ServoConfig],
    head: HeadModel,
    baud_rate: int,
    memory: ServoMemory,
) -> Iterator[Finding]:
    """Find all problems in the registers of a servo of a supported model."""
    get = memory.get
    model, firmware = get(table.MODEL_NUMBER), get(table.FIRMWARE_VERSION)
    name = model_name(model)
    if firmware < _WATCHDOG_FIRMWARE:
        yield _of(
            servo,
            f"expected firmware {_WATCHDOG_FIRMWARE} or later, the first that stops the servo when "
            f"nobody speaks, got {firmware}",
            f"renew it {_WIZARD}",
        )
    elif model in _UNRELIABLE_WATCHDOG_MODELS and firmware <= _UNRELIABLE_WATCHDOG_FIRMWARE:
        yield _of(
            servo,
            f"expected firmware later than {_UNRELIABLE_WATCHDOG_FIRMWARE} of {name}, got "
            f"{firmware}, of which users report that its watchdog does not stop the motor",
            f"renew it {_WIZARD}, or keep a switch of the power at hand",
            warning=True,
        )
    drive_mode = get(table.DRIVE_MODE)
    set_bits = [bit for bit in range(8) if drive_mode >> bit & 1]
    words = [text for bit, text in _DRIVE_MODES.items() if bit in set_bits]
    reversal = ", ".join(words or [f"bit {bit}" for bit in set_bits])
    for register, value, reason in (
        (table.STATUS_RETURN_LEVEL, 2, ": it does not answer to writes"),
        (table.PROTOCOL_TYPE, 2, ""),
        (table.DRIVE_MODE, 0, f" ({reversal})"),
        (table.HOMING_OFFSET, 0, " (`zero_ticks` in the configuration is for that)"),
    ):
        if (got := get(register)) != value:
            problem = f"expected {value} in {register.name}, got {got}{reason}"
            yield _of(servo, problem, f"set it to {value} {_WIZARD}")
    number = get(table.BAUD_RATE)
    known = number < len(table.BAUD_RATES)
    if not known or table.BAUD_RATES[number] != baud_rate:
        shown = f"{table.BAUD_RATES[number]} baud" if known else f"the number {number}"
        yield _of(
            servo,
            f"expected {baud_rate} baud, as in the configuration, got {shown} in BAUD_RATE",
            f"set it {_WIZARD}, or bus.baud_rate in the configuration",
        )
    mode = get(table.OPERATING_MODE)
    if mode != table.VELOCITY_MODE and get(table.TORQUE_ENABLE):
        yield _of(
            servo,
            f"expected velocity mode ({table.VELOCITY_MODE}) or no torque, got torque in mode "
            f"{mode}: to change the mode would drop the joint",
            f"hold the head, and {_POWER_CYCLE_CURE}",
        )
    limit, head_rad_s = get(table.VELOCITY_LIMIT), float(head.actuation.velocity[servo.slot])
    # the limit is in whole units of the servo's speed
    if (limit + 1) * table.TICK_RAD_S / servo.gear_ratio < head_rad_s:
        servo_rad_s = limit * table.TICK_RAD_S / servo.gear_ratio
        yield _of(
            servo,
            f"expected a VELOCITY_LIMIT of at least {head_rad_s:.3g} rad/s of the joint, as the "
            f"head's model has it, got {servo_rad_s:.3g} rad/s ({limit})",
            f"raise it {_WIZARD}, or lower velocity_rad_s in the head file",
            warning=limit > 0,
        )
    factory = table.factory_velocity_gains(model)
    gains = get(table.VELOCITY_I_GAIN), get(table.VELOCITY_P_GAIN)
    if gains not in factory:
        expected = " or ".join(f"{i} and {p}" for i, p in factory)
        yield _of(
            servo,
            f"expected {expected} in VELOCITY_I_GAIN and VELOCITY_P_GAIN, as {name} "
            f"has them from the factory, got {gains[0]} and {gains[1]}",
            "switch its power off and on, or measure how it follows: `vergence measure-delay`",
            warning=True,
        )
    second = get(table.SECONDARY_ID)
    if second < table.NO_SECONDARY_ID and second != servo.id:
        others = [one.name for one in servos if one.id == second]
        obeys = f", so it obeys {others[0]} too, without an answer" if others else ""
        yield _of(
            servo,
            f"expected 255 in SECONDARY_ID, for none, got {second}{obeys}",
            f"set it to 255 {_WIZARD}",
            warning=not others,
        )
    limits = limits_of(memory)
    level, text = judge_voltage(limits, 0.1 * get(table.PRESENT_INPUT_VOLTAGE))
    if level:
        cure = f"a supply with the voltage of {name} that holds it under load"
        yield _of(servo, text, cure, warning=level == Level.WARN)
    level, text = judge_temperature(limits, float(get(table.PRESENT_TEMPERATURE)))
    if level:
        yield _of(servo, text, "let it cool down")
    errors = get(table.HARDWARE_ERROR_STATUS)
    if errors:
        yield _of(
            servo,
            f"expected no latched fault, got one of {describe_fault_bits(errors)} (hardware error "
            f"status 0b{errors:08b})",
            f"remove the cause, then {_POWER_CYCLE_CURE}",
        )


def _measure_exchange_s(bus: Bus, ids: Collection[int]) -> float:
    """A great time of several from a sync read to its last answer, s; 0 without answers."""
    times = []
    address, length = MOTION_SPAN
    for place in range(_EXCHANGES if ids else 0):
        # answers may come one by one; a length of its own exposes one that comes later still
        timeout_s = bus.single_timeout_s * len(ids)
        answers = bus.sync_read(ids, address, length + place % 2, timeout_s=timeout_s)
        if len(answers) == len(ids):
            times += [bus.exchange_s]
    return sorted(times)[min(_COUNTED_EXCHANGE, len(times) - 1)] if times else 0.0


def cycle_timeout_s(exchange_s: float, period_s: float) -> float:
    """Timeout of the answers in a control period, by the measured time of an exchange, s."""
    longest_s = _MAX_TIMEOUT_FRACTION * period_s
    return max(CYCLE_TIMEOUT_S, min(_TIMEOUT_RATIO * exchange_s, longest_s))


def exchange_time_s(count: int, baud_rate: int, return_delays_s: float, latency_s: float) -> float:
    """Time of one period's exchange with some servos, see the module's description, s."""
    size = 2 * _FRAME_BYTES + count * (_GOAL_BYTES + 1 + _ANSWER_BYTES)
    return 10.0 * size / baud_rate + return_delays_s + latency_s


def check_exchange(
    bus: Bus,
    head: HeadModel,
    count: int,
    return_delays: Mapping[str, int],
    sysfs: str = "/sys",
    read_s: float = 0.0,
) -> Iterator[Finding]:
    """Check that the exchange with the servos fits into a control period."""
    period_s, rate = head.timing.period_s, bus.line.baud
    delays_s = _RETURN_DELAY_UNIT_S * sum(return_delays.values())
    line_s = exchange_time_s(count, rate, delays_s, 0.0)
    write_s = 10.0 * (_FRAME_BYTES + count * _GOAL_BYTES) / rate
    timer_s = 1e-3 * _latency_timer_ms(bus.port, sysfs)
    latency_s = max(timer_s, write_s + read_s - line_s)
    taken_s, longest_s = line_s + latency_s, _MAX_EXCHANGE_FRACTION * period_s
    if taken_s > longest_s:
        cures = ["a higher baud rate in servos and configuration"]
        if line_s + 1e-3 * _MIN_LATENCY_TIMER_MS <= longest_s:
            timer = check_latency_timer(bus.port, sysfs)
            cures = [
                "an adapter that passes answers on within 1 ms" if timer is None else timer.cure
            ]
        elif delays_s:
            cures.append("RETURN_DELAY_TIME 0")
        highest_hz = int(_MAX_EXCHANGE_FRACTION / taken_s)
        cures.append(f"or a control_rate_hz of {highest_hz} at most in the head file")
        yield Finding(
            part="bus",
            problem=f"expected an exchange within {_MAX_EXCHANGE_FRACTION:.0%} of the control "
            f"period of {1e3 * period_s:.3g} ms, got {1e3 * taken_s:.3g} ms at {rate} "
            f"baud, of which {1e3 * delays_s:.3g} ms are return delays and "
            f"{1e3 * latency_s:.3g} ms the adapter's latency",
            cure=", ".join(cures),
        )
    elif delays_s > _DELAY_WARNING_FRACTION * period_s:
        slow = ", ".join(f"{name} {delay}" for name, delay in return_delays.items() if delay)
        yield Finding(
            part="bus",
            problem=f"expected a RETURN_DELAY_TIME of 0, got {slow}: {1e3 * delays_s:.3g} ms "
            f"of each control period of {1e3 * period_s:.3g} ms",
            cure="set it to 0 with ROBOTIS's Dynamixel Wizard",
            warning=True,
        )

"""Checks of the serial line: its port, its adapter, and its time within a control period.

In each period a sync write of n goals and a sync read of n states take, with the return delays of
the answers and the latency of the adapter, the time

    t = 10 bits (28 + 6 n + 19 n) / rate + sum of the return delays + latency.

The latency of most adapters can only be measured, by exchanges with the servos.
"""

import os
from collections.abc import Collection, Mapping
from glob import glob
from pathlib import Path
from typing import Final

from vergence.errors import ChecksFailedError, Finding, HardwareError
from vergence.hardware.config import BusConfig, HardwareConfig
from vergence.hardware.dynamixel.bus import CYCLE_TIMEOUT_S, Bus
from vergence.hardware.servo_memory import MOTION_SPAN

RETURN_DELAY_UNIT_S: Final = 2e-6
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


def serial_ports() -> list[str]:
    """Serial ports of this machine that may be an adapter, persistent names first."""
    return [port for pattern in _PORTS for port in sorted(glob(pattern))]


def open_bus(config: BusConfig) -> Bus:
    """Open the line of the servos.

    Raises:
        ChecksFailedError: the port does not exist, is open in another process or cannot be opened;
            the finding names the cure.
    """
    if not os.path.exists(config.port):
        there = ", ".join(serial_ports()) or "none"
        raise ChecksFailedError(
            [
                Finding(
                    part="bus",
                    problem=f"expected a serial port, got {config.port}: no such device",
                    cure=f"plug the adapter in, or name one of the ports that are there: {there}",
                )
            ]
        )
    try:
        return Bus(config.port, config.baud_rate)
    except HardwareError as error:
        raise ChecksFailedError(
            [Finding(part="bus", problem=str(error), cure=_cure(config.port, str(error)))]
        ) from error


def _cure(port: str, problem: str) -> str:
    if "permission" in problem:
        return "sudo usermod -aG dialout $USER, then log out and in again"
    if "another process" in problem:
        return f"end the other program; fuser -v {port} names it"
    return ""


def check_latency_timer(port: str, sysfs: str = "/sys") -> Finding | None:
    """Check the latency timer of an FTDI adapter, on Linux.

    Args:
        port: the device file of the line.
        sysfs: mount point of sysfs.
    """
    name = os.path.basename(os.path.realpath(port))
    latency_ms = latency_timer_ms(port, sysfs)
    if latency_ms <= _MIN_LATENCY_TIMER_MS:
        return None
    return Finding(
        part="bus",
        problem=f"expected a latency timer of {_MIN_LATENCY_TIMER_MS} ms of {name}, got "
        f"{latency_ms} ms, "
        "which every answer waits for",
        cure=f"echo {_MIN_LATENCY_TIMER_MS} | sudo tee "
        f"/sys/bus/usb-serial/devices/{name}/latency_timer",
        warning=True,
    )


def latency_timer_ms(port: str, sysfs: str = "/sys") -> int:
    """Read the latency timer of an FTDI adapter, ms; 0 for other ports and systems."""
    name = os.path.basename(os.path.realpath(port))
    path = Path(sysfs, "bus/usb-serial/devices", name, "latency_timer")
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0


def exchange_time_s(
    servo_count: int, baud_rate: int, return_delays_s: float, latency_s: float
) -> float:
    """Time of one period's exchange with the servos, see the module's description, s.

    Args:
        servo_count: number of servos.
        baud_rate: baud rate, bit/s.
        return_delays_s: sum of their return delays, s.
        latency_s: latency of the adapter, s.
    """
    instructions = 2 * _FRAME_BYTES + servo_count * (_GOAL_BYTES + 1)
    return (
        10.0 * (instructions + servo_count * _ANSWER_BYTES) / baud_rate
        + return_delays_s
        + latency_s
    )


def measure_exchange_s(bus: Bus, ids: Collection[int]) -> float:
    """Measure the time from a sync read of angles and speeds to its last answer, s.

    Args:
        bus: the line.
        ids: ids of servos that answer.

    Returns:
        A great time of several; 0 without answers.

    Raises:
        HardwareError: the line is gone.
    """
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


def _exchange_cure(
    config: HardwareConfig, sysfs: str, line_s: float, delays_s: float, taken_s: float
) -> str:
    """Name what makes an exchange fit into the control period."""
    longest_s = _MAX_EXCHANGE_FRACTION * config.head.timing.period_s
    cures = []
    if line_s + 1e-3 * _MIN_LATENCY_TIMER_MS <= longest_s:
        timer = check_latency_timer(config.bus.port, sysfs)
        cures.append(
            "an adapter that passes answers on within 1 ms" if timer is None else timer.cure
        )
    else:
        cures.append("a higher baud rate in servos and configuration")
        if delays_s:
            cures.append("RETURN_DELAY_TIME 0")
    highest_hz = int(_MAX_EXCHANGE_FRACTION / taken_s)
    return ", ".join([*cures, f"or a control_rate_hz of {highest_hz} at most in the head file"])


def check_exchange_fits_period(
    config: HardwareConfig,
    return_delays: Mapping[str, int],
    sysfs: str = "/sys",
    read_s: float = 0.0,
) -> list[Finding]:
    """Check that the exchange with the servos fits into a control period.

    Args:
        config: the robot.
        return_delays: RETURN_DELAY_TIME by the servo's name, for those that have been read.
        sysfs: mount point of sysfs.
        read_s: measured time of a sync read and its answers, s; 0 if it is unknown.
    """
    period_s = config.head.timing.period_s
    delays_s = RETURN_DELAY_UNIT_S * sum(return_delays.values())
    count, rate = len(config.servos), config.bus.baud_rate
    line_s = exchange_time_s(count, rate, delays_s, 0.0)
    write_s = 10.0 * (_FRAME_BYTES + count * _GOAL_BYTES) / rate
    timer_s = 1e-3 * latency_timer_ms(config.bus.port, sysfs)
    latency_s = max(timer_s, write_s + read_s - line_s)
    taken_s = line_s + latency_s
    slow = ", ".join(f"{name} {delay}" for name, delay in return_delays.items() if delay)
    findings = []
    if taken_s > _MAX_EXCHANGE_FRACTION * period_s:
        findings.append(
            Finding(
                part="bus",
                problem=f"expected an exchange within {_MAX_EXCHANGE_FRACTION:.0%} of the "
                "control period of "
                f"{1e3 * period_s:.3g} ms, got {1e3 * taken_s:.3g} ms at {config.bus.baud_rate} "
                f"baud, of which {1e3 * delays_s:.3g} ms are return delays and "
                f"{1e3 * latency_s:.3g} ms the adapter's latency",
                cure=_exchange_cure(config, sysfs, line_s, delays_s, taken_s),
            )
        )
    elif delays_s > _DELAY_WARNING_FRACTION * period_s:
        findings.append(
            Finding(
                part="bus",
                problem=f"expected a RETURN_DELAY_TIME of 0, got {slow}: {1e3 * delays_s:.3g} ms "
                f"of each control period of {1e3 * period_s:.3g} ms",
                cure="set it to 0 with ROBOTIS's Dynamixel Wizard",
                warning=True,
            )
        )
    return findings

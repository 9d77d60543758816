"""An emulated head in processes of its own plays the faults of its script."""

import time
from contextlib import closing

import pytest

from tests.hardware.emulated import REAL_TIME, emulated
from vergence.errors import HardwareError
from vergence.hardware.config import load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.emulator.client import WorldClient

pytestmark = [*REAL_TIME, pytest.mark.nightly]

IDS = (1, 2, 3, 4)
WATCHDOG_S = 0.2
SCRIPT = """
[[fault]]
what = "unplug"
at_s = 2.0
"""


def speak_until_gone(bus):
    spoken_s = time.monotonic()
    try:
        while True:
            bus.sync_read(IDS, table.PRESENT_VELOCITY.address, 8)
            spoken_s = time.monotonic()
    except HardwareError:
        return spoken_s


def test_a_script_pulls_the_cable_and_the_watchdogs_bring_the_joints_to_rest(tmp_path):
    script = tmp_path / "faults.toml"
    script.write_text(SCRIPT)
    with emulated(tmp_path, "--faults", str(script)) as (desk, _process):
        config = load_hardware(desk)
        with (
            closing(Bus(config.bus.port, cycle_timeout_s=0.1)) as bus,
            closing(WorldClient(config.emulator_address)) as world,
        ):
            for id in IDS:
                bus.write(id, table.OPERATING_MODE, table.VELOCITY_MODE)
                bus.write(id, table.BUS_WATCHDOG, round(WATCHDOG_S / table.WATCHDOG_S))
                bus.write(id, table.TORQUE_ENABLE, 1)
            bus.sync_write(table.GOAL_VELOCITY, dict.fromkeys(IDS, 20))
            spoken_s = speak_until_gone(bus)
            until_s = spoken_s + 20.0
            while (rested_s := world.rest_start_s(spoken_s)) is None:
                assert time.monotonic() < until_s
    # the watchdog, and three time constants of the joints from 0.5 to 0.024 rad/s
    assert WATCHDOG_S - 0.05 < rested_s - spoken_s < WATCHDOG_S + 0.3

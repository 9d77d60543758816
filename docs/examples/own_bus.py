"""A bus of your own, to copy.

In `desk.toml`, beside which this file lies, write

    [bus]
    kind = "own_bus.py:OwnBus"
    lag_s = 0.03                 # all other keys are arguments of the class

Fill each method with what your servos understand. Here they live in memory, and turn as motors
with a lag. With `world = "127.0.0.1:40000"`, the address that `vergence emulate --out desk.toml`
has written under [emulator], its cameras show them: `vergence deploy saccade --config desk.toml`.
"""

import numpy as np

from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.servos import ServoReading, Servos


class OwnBus(Servos):
    """Servos that turn as they are told until somebody tells them otherwise."""

    stops_alone_after_s = None  # a time, s, if they stop by themselves when nobody speaks
    reports_speed = False  # speeds are then computed from angles

    def __init__(self, servos, head, clock, *, lag_s=0.03, world=""):
        super().__init__(servos, head, clock)
        self._lag_s, self._address, self._world = lag_s, world, None
        self._zero = np.array([one.zero * one.unit_rad for one in servos])  # rad
        self._limit = np.array([head.actuation.velocity[one.slot] for one in servos])  # rad/s
        self._angles, self._time_s = self._zero.copy(), clock()
        self._speeds, self._goals = np.zeros((2, len(servos)))
        self._torque = np.zeros(len(servos), dtype=bool)

    def open(self):
        """Open the device; write nothing yet."""
        self._world = WorldClient(self._address) if self._address else None

    def check(self):
        """Return a list of `vergence.errors.Finding`; called once a second while they run."""
        return []

    def switch_on(self, which):
        """Give torque to the servos that are True in `which`, (n,), at rest."""
        self._goals[which] = 0.0
        self._torque |= which
        return []

    def read(self):
        """Ask all servos: their time, angles and speeds, and how old the angles are."""
        self._turn()
        return ServoReading(self._time_s, self._angles.copy(), self._speeds, 0.0 * self._speeds)

    def send(self, speeds):
        """Send (n,) speeds of the shafts, rad/s; return what the servos have got."""
        self._turn()
        limit = self._limit * self._torque
        self._goals = np.clip(speeds, -limit, limit)
        return self._goals.copy()

    def stop(self):
        """Send zero to all at once."""
        self._goals[:] = 0.0

    def release(self, which):
        """Take the torque of the servos that are True in `which`, (n,)."""
        self._turn()
        self._goals[which] = 0.0
        self._torque &= ~which

    def close(self):
        """Release the device; the servos stay as they are."""
        if self._world is not None:
            self._world.close()
            self._world = None

    def _turn(self):
        """Let the motors turn until now."""
        now_s = self.clock()
        passed_s, self._time_s = now_s - self._time_s, now_s
        left = np.exp(-passed_s / self._lag_s)
        behind = self._speeds - self._goals
        self._angles = self._angles + self._goals * passed_s + behind * self._lag_s * (1.0 - left)
        self._speeds = self._goals + behind * left
        if self._world is not None:  # the emulated cameras
            turns = (self._angles - self._zero) * [one.sign / one.gear_ratio for one in self.servos]
            names = [one.name for one in self.servos]
            self._world.turn(dict(zip(names, turns.tolist(), strict=True)))

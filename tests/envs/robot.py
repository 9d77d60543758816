"""A head as hardware offers it: no seeds, no truth, no images, only what its sensors report."""

import numpy as np

from vergence.envs.plant import Plant
from vergence.envs.reading import Reading, Truth
from vergence.errors import ConfigurationError

WORLD = (0.05, -0.12, 0.9)
"""Position of the target in the robot's world, in N, m."""
LATENCY = 8
"""Control periods from an exposure to the first step at which its image is readable."""
EARLIER_S = 0.0013
"""By how much the exposures that the robot measures are earlier than that."""


class Robot(Plant):
    """A head whose joints follow at once, and that measures when its images were exposed."""

    def __init__(self, head, num=1):
        self.head, self.num = head, num
        self.open = True
        self.calls = []
        self._reading = Reading.empty(num)

    def prepare(self):
        self.calls.append("prepare")

    def reset(self, ids, positions):
        self.calls.append("reset")
        blank = Reading.empty(len(ids))._replace(positions=positions)
        for now, begun in zip(self._reading, blank, strict=True):
            now[ids] = begun
        self._angles = [self._reading.positions.copy()]
        return self._reading

    def step(self, command):
        self.calls.append("step")
        if np.isnan(command).any():
            raise ConfigurationError("command: expected numbers, got nan")
        reading, period = self._reading, self.head.timing.period_s
        limit = self.head.actuation.velocity
        reading.command[:] = np.clip(command, -limit, limit)
        reading.velocities[:] = reading.command
        reading.positions[:] += reading.command * period
        reading.time_s[:] += period
        reading.joints_s[:] = reading.time_s
        self._angles.append(reading.positions.copy())
        if len(self._angles) > LATENCY:
            then = self._angles[-1 - LATENCY]
            reading.frame[:] += 1
            reading.pixels[:] = self.head.project(then, WORLD)
            reading.visible[:] = True
            reading.exposure_s[:] = reading.time_s - LATENCY * period - EARLIER_S
            reading.received_s[:] = reading.time_s
            reading.positions_at_exposure[:] = then
        return reading

    def close(self):
        self.calls.append("close")
        self.open = False
        self._reading.command[:] = self._reading.velocities[:] = 0.0


class Emulated(Robot):
    """A robot whose world takes targets, and says where they and the joints are."""

    places_targets = True

    def show(self, ids, motions):
        self.calls.append("show")
        self.shown = motions

    def truth(self):
        q, target = self._reading.positions, np.tile(WORLD, (self.num, 1))
        pixels = self.head.project(q, target)
        return Truth.unknown(self.num)._replace(
            time_s=self._reading.time_s.copy(), positions=q.copy(), target=target, pixels=pixels,
            pixel_error=self.head.project(q, target, distorted=False) - self.head.cameras.principal,
        )  # fmt: skip


class Late(Plant):
    """A robot whose steps end late: by up to 0.4 periods, and by 1.5 in each seventh, about.

    It sees by a camera of 60 frames a second with a clock of its own, and does not turn.
    """

    def __init__(self, head, num=1, *, seed=0):
        self.head, self.num = head, num
        self.blind = False
        self._seed = seed

    def reset(self, ids, positions):
        self._rng = np.random.default_rng(self._seed)
        self._reading = Reading.empty(1)._replace(positions=positions.copy())
        self.steps = self._period = 0
        return self._reading

    def step(self, command):
        rng, reading, period = self._rng, self._reading, self.head.timing.period_s
        self.steps += 1
        self._period += 1
        late = 1.5 if rng.random() < 1 / 7 else rng.uniform(0.0, 0.4)
        clock_s = (self._period + late) * period
        self._period += int(late)  # the period that was missed is skipped
        reading.time_s[0] = self._period * period
        newest = int(np.floor((clock_s - 0.06) * 60.0))  # exposed, and come
        if newest >= 0:
            reading.frame[0] = newest + 1
            reading.exposure_s[0], reading.received_s[0] = newest / 60.0, clock_s
            reading.visible[0] = not self.blind
            reading.pixels[0] = np.nan if self.blind else self.head.project(np.zeros(7), WORLD)
        return reading

    def close(self):
        """See `Plant.close`."""

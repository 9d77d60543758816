"""Check that the safety layer keeps joints within their bounds under hostile policies.

Run ``python benchmarks/safety.py --sequences 100000``. Each sequence has a random head and loop,
random bounds and start, and a hostile policy; its joints follow the commands by the package's
model. It prints the largest excess of position, speed and acceleration, and if a forbidden posture
was entered. With ``--late`` each command lasts a random time of 1 to 1.5 periods; accelerations may
be exceeded then, as a joint that has lost time is braked harder. With ``--ends`` the sender of the
commands dies at a random moment: the last command stays until the servos' watchdog sets it to
zero, without a bound on acceleration.
"""

import argparse
import dataclasses
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
from rich.console import Console
from rich.progress import track

from vergence import load_head
from vergence.hardware.safety.limits import ForbiddenPosture, JointMotionLimiter, SafetyConfig
from vergence.models.motion import follow_joint, lag_decay

CHUNK = 100
LATEST = 1.5
"""Longest duration of a late command, periods, as ensured by `DriveThread`."""
NAMES = ("turrets", "icub", "simulated")
POLICIES = ("flips", "keeps", "trembles", "swings")


class Joints:
    """Seven joints that follow their commands by the package's model, after a latency.

    Args:
        head: model of the head.
        angles: (7,) initial angles, rad.
    """

    def __init__(self, head, angles):
        self.angles, self.speeds = np.array(angles), np.zeros(7)
        self._period_s = head.timing.period_s
        self._lag_s = head.timing.lag_s * head.actuation.lag_ratio
        self._acceleration = np.where(
            head.actuation.acceleration > 0, head.actuation.acceleration, 1e9
        )
        late = round(np.ceil(head.timing.command_latency_s / self._period_s - 1e-9))
        self._sent = deque([np.zeros(7)] * late)

    def step(self, command, periods=1.0):
        """Send a command and simulate some periods."""
        held_s = periods * self._period_s
        self._sent.append(command)
        acts = self._sent.popleft()
        for j in range(7):
            lag_s = float(self._lag_s[j])
            self.angles[j], self.speeds[j] = follow_joint.py_func(
                float(self.angles[j]), float(self.speeds[j]), float(acts[j]), lag_s,
                float(self._acceleration[j]), held_s,
                lag_decay.py_func(held_s, lag_s),
            )  # fmt: skip


def drawn_head(rng):
    """Head with random loop timing."""
    head = load_head(str(rng.choice(NAMES)))
    rate_hz = float(rng.choice([30.0, 60.0, 120.0, 250.0]))
    timing = dataclasses.replace(
        head.timing,
        control_rate_hz=rate_hz,
        lag_s=float(rng.choice([0.0, 0.002, 0.01, 0.03, 0.08, 0.2])),
        command_latency_s=float(rng.choice([0.0, 0.0, 1.0, 2.5])) / rate_hz,
    )
    return dataclasses.replace(head, timing=timing)


def drawn_config(rng, head):
    """Random bounds of speed and acceleration, and often a forbidden posture."""
    forbidden = ()
    slots = np.arange(3, 3 + head.actuation.count)
    if len(slots) > 1 and rng.random() < 0.6:
        two = rng.choice(slots, 2, replace=False)
        middle = rng.uniform(head.actuation.lower[two], head.actuation.upper[two])
        half = rng.uniform(0.05, 0.5, 2)
        forbidden = (
            ForbiddenPosture(
                name="the frame",
                slots=tuple(map(int, two)),
                lower=middle - half,
                upper=middle + half,
            ),
        )
    return SafetyConfig(
        speed_rad_s=float(rng.choice([np.inf, 2.0])),
        acceleration_rad_s2=float(rng.choice([np.inf, 30.0])),
        forbidden=forbidden,
    )


def drawn_start(rng, head, forbidden):
    """Random posture with some margin to each bound; None if it is near a forbidden posture."""
    lower, upper = head.actuation.lower, head.actuation.upper
    angles = np.where(
        upper > lower, rng.uniform(lower + 0.002, np.maximum(upper - 0.002, lower + 0.003)), 0.0
    )
    for posture in forbidden:
        near = angles[list(posture.slots)]
        if ((near > posture.lower - 0.02) & (near < posture.upper + 0.02)).all():
            return None
    return angles


def requested_velocities(rng, style, steps):
    """(steps, 7) requested velocities of a policy that ignores all bounds, rad/s."""
    if style == "flips":
        return rng.choice([-np.inf, np.inf, 0.0, 1.0], (steps, 7))
    if style == "keeps":
        return np.repeat(rng.normal(0.0, 6.0, (steps // 17 + 1, 7)), 17, axis=0)[:steps]
    if style == "trembles":
        return rng.normal(0.0, 6.0, (steps, 7))
    sides = np.where(np.arange(steps) // 25 % 2, 1.0, -1.0)
    return np.outer(sides, np.full(7, np.inf))


def exceeded(rng, style, steps=60, how=""):
    """(4,) largest excess of a random head: position, speed, acceleration, forbidden posture."""
    head = drawn_head(rng)
    config = drawn_config(rng, head)
    start = drawn_start(rng, head, config.forbidden)
    if start is None:
        return np.zeros(4)
    lower, upper = head.actuation.lower, head.actuation.upper
    last_s = float(rng.choice([0.1, 0.3])) if how == "ends" else 0.0
    motion, joints = JointMotionLimiter(head, lower, upper, config, last_s), Joints(head, start)
    requested = list(requested_velocities(rng, style, steps))
    end = rng.integers(1, steps) if how == "ends" else steps
    there = upper > lower
    worst = np.zeros(4)
    for step in range(steps):
        if step <= end:
            command = motion.limit_velocities(
                joints.angles, joints.speeds, requested[step], motion.max_speed
            )
            motion.advance(command)
        else:
            command = np.zeros(7)
        before = joints.speeds.copy()
        periods = rng.uniform(1.0, LATEST) if how == "late" else 1.0
        if step == end:
            periods = max(last_s / head.timing.period_s, 1.0)
        joints.step(command, periods)
        beyond = np.maximum(joints.angles - upper, lower - joints.angles)[there].max()
        over_s = periods * head.timing.period_s
        change = np.abs(joints.speeds - before) / over_s / motion.acceleration - 1.0
        entered = any(one.contains(joints.angles) for one in config.forbidden)
        now = beyond, (np.abs(joints.speeds) - motion.max_speed).max(), change[there].max(), entered
        worst = np.maximum(worst, now)
    return worst


def chunk(first: int, seed: int, how: str) -> np.ndarray:
    """Largest excess over `CHUNK` sequences."""
    worst = np.zeros(4)
    for number in range(first, first + CHUNK):
        rng = np.random.default_rng((seed, number))
        worst = np.maximum(worst, exceeded(rng, POLICIES[number % len(POLICIES)], how=how))
    return worst


def main() -> None:
    """Run all sequences and print the largest excess."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--late", dest="how", action="store_const", const="late", default="")
    parser.add_argument("--ends", dest="how", action="store_const", const="ends", default="")
    options = parser.parse_args()
    firsts = range(0, options.sequences, CHUNK)
    worst, one_chunk = np.zeros(4), partial(chunk, seed=options.seed, how=options.how)
    # forked: a script's functions are found in its copies alone
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("fork")) as pool:
        found = pool.map(one_chunk, firsts)
        for one in track(found, "sequences", total=len(firsts), console=Console(stderr=True)):
            worst = np.maximum(worst, one)
    print(f"{options.sequences} sequences; the most that was exceeded:")
    for name, value, unit in zip(
        ("position", "speed", "acceleration", "forbidden postures"),
        worst,
        ("rad", "rad/s", "of its bound", "entered"),
        strict=True,
    ):
        print(f"  {name}: {value:.3g} {unit}")
    most = np.array([0.0, 1e-9, np.inf if options.how else 1e-9, 0.0])
    raise SystemExit(int((worst > most).any()))


if __name__ == "__main__":
    main()

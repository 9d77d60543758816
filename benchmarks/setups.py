"""Count the wrong set-ups of a robot that are named, and the right ones that are refused.

Run ``python -m benchmarks.setups``. Both heads `turrets` and `icub` are set up wrongly, one mistake
at a time, and 50 times rightly: with friction, gravity, backlash, other lags, gains and latencies
than their files', and zeros set by eye. It runs in simulated time, for some four minutes. The exit
status is 1 if a mistake is not named or a right head is refused.
"""

import argparse
import dataclasses
import logging
import re
import warnings
from typing import Any

import numpy as np
import pytest
from rich.progress import track

from tests.hardware.virtual import VirtualRobot, WatchedWorld, virtual_config
from vergence import load_head
from vergence.errors import VergenceError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.dynamixel.control_table import CENTRE_TICKS, TICK_RAD
from vergence.hardware.emulator.config import EmulatorConfig
from vergence.hardware.servos import ServoConfig
from vergence.models.head import HeadModel

POINT = np.array([0.03, -0.05, 0.9])
ZERO_SIGMA_RAD = 0.015
COMMON = {
    "cameras exchanged": ({"eyes": (1, 0)}, "exchanged"),
    "images upside down": ({"flips": (0, 1)}, "upside down"),
    "target never seen": ({"blind": True}, "without it from both cameras"),
}
WRONG: dict[str, dict[str, tuple[dict[str, Any], str]]] = {
    "turrets": {
        **COMMON,
        "one image upside down": ({"flips": (0,)}, "cameras.left"),
        "pan's sign": ({"sign": "left_pan"}, "left_pan: .*sign"),
        "tilt's sign": ({"sign": "right_tilt"}, "right_tilt: .*sign"),
        "ids of the pans": ({"ids": ("left_pan", "right_pan")}, "left_pan, right_pan: .*ids"),
        "ids of an eye": ({"ids": ("left_pan", "left_tilt")}, "left_pan, left_tilt: .*ids"),
        "zero of a tilt, 0.18": ({"zero": ("left_tilt", 0.18)}, "left_tilt.*zero"),
        "zero of a tilt, 0.5": ({"zero": ("left_tilt", 0.5)}, "zeros of the left eye"),
        "goals doubled": ({"goal-scale": ("left_pan", 2.0)}, "left_pan: .*GOAL_VELOCITY"),
        "goals reversed": ({"goal-scale": ("left_pan", -1.0)}, "left_pan: .*sign of its speeds"),
        "speeds halved": ({"speed-scale": ("left_tilt", 0.5)}, "left_tilt: .*PRESENT_VELOCITY"),
        "speeds reversed": ({"speed-scale": ("left_tilt", -1.0)}, "the sign .*PRESENT_VELOCITY"),
        "gear": ({"gear": ("right_pan", 2.0)}, "right_pan: .*gear_ratio"),
    },
    "icub": {
        **COMMON,
        "tilt's sign": ({"sign": "eyes_tilt"}, "eyes_tilt: .*sign"),
        "version's sign": ({"sign": "eyes_version"}, "eyes_version: .*sign"),
        "ids": ({"ids": ("eyes_tilt", "eyes_version")}, "eyes_tilt, eyes_version: .*ids"),
        "zero of the vergence, 0.18": ({"zero": ("eyes_vergence", 0.18)}, "eyes_vergence"),
        "goals doubled": ({"goal-scale": ("eyes_version", 2.0)}, "eyes_version: .*GOAL_VELOCITY"),
        "goals reversed": ({"goal-scale": ("eyes_version", -1.0)}, "eyes_version: .*of its speeds"),
        "speeds doubled": ({"speed-scale": ("eyes_tilt", 2.0)}, "eyes_tilt: .*PRESENT_VELOCITY"),
        "speeds reversed": ({"speed-scale": ("eyes_tilt", -1.0)}, "the sign .*PRESENT_VELOCITY"),
        "gear": ({"gear": ("eyes_version", 0.5)}, "eyes_version: .*gear_ratio"),
    },
}
"""Mistakes by head and name, each with a pattern of the message that names it."""


def changed(servos: tuple[ServoConfig, ...], name: str, **values: Any) -> tuple[ServoConfig, ...]:
    """Servos of which one has other values."""
    return tuple(dataclasses.replace(one, **values) if one.name == name else one for one in servos)


def set_up(config: HardwareConfig, mistake: dict[str, Any]) -> HardwareConfig:
    """Configuration with a mistake."""
    servos = config.servos
    ids = {servo.name: servo.id for servo in servos}
    if "sign" in mistake:
        servos = changed(servos, mistake["sign"], sign=-1)
    if "ids" in mistake:
        one, other = mistake["ids"]
        servos = changed(changed(servos, one, id=ids[other]), other, id=ids[one])
    if "zero" in mistake:
        name, off_rad = mistake["zero"]
        servos = changed(servos, name, zero=CENTRE_TICKS + round(off_rad / TICK_RAD))
    if "gear" in mistake:
        name, gear_ratio = mistake["gear"]
        servos = changed(servos, name, gear_ratio=gear_ratio, lower_rad=-0.35, upper_rad=0.35)
    return dataclasses.replace(config, servos=servos)


def begin(
    head: HeadModel,
    config: HardwareConfig,
    mistake: dict[str, Any],
    world: WatchedWorld,
) -> str:
    """Begin a trial; return the message that refuses it, or the warnings."""
    size = head.cameras.size
    flips = {eye: lambda pixel, eye=eye: size[eye] - 1 - pixel for eye in mistake.get("flips", ())}
    if "blind" in mistake:
        flips = {eye: lambda pixel: pixel + np.nan for eye in range(2)}
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        robot = VirtualRobot(
            patch, world, config, (flips.get(0), flips.get(1)), mistake.get("eyes", (0, 1))
        )
        try:
            robot.plant.prepare()
            for what in ("goal-scale", "speed-scale"):
                if what in mistake:
                    name, value = mistake[what]
                    ids = [servo.id for servo in config.servos if servo.name == name]
                    robot.fault(what=what, ids=ids, value=value)
            robot.begin()
        except VergenceError as error:
            return str(error)
        finally:
            robot.plant.close()
    return "; ".join(str(one.message) for one in said)


def right(head: HeadModel, seed: int) -> str:
    """Begin a trial of a drawn right head; return what is wrong with it, empty for nothing."""
    rng = np.random.default_rng((11, seed))
    timing = head.timing
    motors = EmulatorConfig(
        friction=rng.uniform(0.0, 0.08), gravity=rng.uniform(0.0, 0.15),
        lag_s=timing.lag_s * rng.uniform(0.6, 2.0), speed_gain=rng.uniform(0.85, 1.15),
        backlash_rad=rng.uniform(0.0, 0.005), command_latency_s=rng.uniform(0.0, 0.015),
    )  # fmt: skip
    point = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 2.0)])
    world = WatchedWorld(
        head, point, motors, latency_s=timing.latency_s * rng.uniform(0.6, 1.3), jitter_s=0.008,
        seed=seed,
    )  # fmt: skip
    config = virtual_config(head, timing.latency_s)
    for servo in config.servos:
        if servo.lower_rad < 0.0:  # else the joint's rest is its end stop
            off = round(rng.normal(0.0, ZERO_SIGMA_RAD) / TICK_RAD)
            servos = changed(config.servos, servo.name, zero=CENTRE_TICKS + off)
            config = dataclasses.replace(config, servos=servos)
    return begin(head, config, {}, world)


def main() -> None:
    """Print each mistake with what is said of it, and the right heads that are refused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--right", type=int, default=50)
    chosen = parser.parse_args()
    logging.disable(logging.CRITICAL)
    missed, refused = 0, 0
    heads = {name: load_head(name) for name in WRONG}
    for name, mistakes in WRONG.items():
        head = heads[name]
        for what, (mistake, pattern) in mistakes.items():
            world = WatchedWorld(head, POINT, latency_s=head.timing.latency_s)
            config = set_up(virtual_config(head, head.timing.latency_s), mistake)
            said = begin(head, config, mistake, world)
            named = re.search(pattern, said) is not None
            missed += not named
            print(f"{'named' if named else 'MISSED':7}{name:8} {what}: {said}", flush=True)
    for seed in track(range(chosen.right), "right set-ups"):
        for name, head in heads.items():
            if seed % len(heads) == list(heads).index(name) and (said := right(head, seed)):
                refused += 1
                print(f"refused {name} {seed}: {said}", flush=True)
    print(f"{missed} mistakes not named; {refused} of {chosen.right} right set-ups refused")
    raise SystemExit(int(missed + refused > 0))


if __name__ == "__main__":
    main()

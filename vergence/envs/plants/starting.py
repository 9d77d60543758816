"""How trials of a simulated plant start: joints at rest, sensors that saw the time before zero."""

from math import nan
from typing import Final

from vergence._jit import compiled
from vergence.envs.plants.conditions import Conditions
from vergence.envs.plants.motors import Motors, feel_angles, place_motors, quantise
from vergence.envs.plants.scene import Scene, eye_pixel, head_of
from vergence.envs.plants.sensing import Frames, Sensor, pixel_noise
from vergence.envs.reading import Reading
from vergence.envs.streams import IntArray, Keys, Purpose
from vergence.envs.targets.motion import MOTION, SEEN_BEFORE, motion_of
from vergence.models.camera import inside_image
from vergence.models.parts import FloatArray

_BEFORE: Final = int(Purpose.BEFORE)


@compiled
def begin(
    ids: IntArray,
    positions: FloatArray,
    motions: FloatArray,
    sensor: Sensor,
    scene: Scene,
    frames: Frames,
    reading: Reading,
    motors: Motors | None,
) -> bool:
    """Bring starting trials to time zero, their joints at rest and their rings empty.

    Args:
        ids: (m,) the trials that start.
        positions: (m, 7) where their joints are, rad.
        motions: (m, MOTION) their targets.
        sensor: `bare`, see `vergence.envs.plants.sensing.sense`, as are the following three.
        scene: the result, with the following two.
        frames: the rings.
        reading: the reading of heads that have seen nothing yet.
        motors: those of heads that have other motors than one a joint.

    Returns:
        Whether some target was there before time zero.
    """
    sensor, scene = Sensor(*sensor), Scene(*scene)
    frames, reading = Frames(*frames), Reading(*reading)
    ring = frames.arrived.shape[1]
    seen_before = False
    for m in range(ids.shape[0]):
        n = ids[m]
        for i in range(MOTION):
            scene.motions[n, i] = motions[m, i]
        seen_before = seen_before or motions[m, SEEN_BEFORE] != 0.0
        scene.step[n] = 0
        for j in range(3):
            scene.necks[n, j] = positions[m, j]
        for j in range(7):
            scene.positions[n, j] = positions[m, j]
            scene.velocities[n, j] = reading.command[n, j] = 0.0
            angle = quantise(positions[m, j], sensor.angle_step_rad)
            reading.positions_at_exposure[n, j] = angle
        if motors is not None:
            moved = Motors(*motors)
            place_motors(moved, scene, n, positions[m])
            feel_angles(moved, n, reading.positions_at_exposure[n])
        for j in range(7):
            for slot in range(ring):
                frames.angles[n, slot, j] = reading.positions_at_exposure[n, j]
        for slot in range(ring):
            frames.arrived[n, slot] = False
        reading.frame[n] = 0
        for eye in range(2):
            reading.visible[n, eye] = False
            reading.pixels[n, eye, 0] = reading.pixels[n, eye, 1] = nan
        reading.exposure_s[n] = reading.received_s[n] = nan
    return seen_before


@compiled
def expose_before(
    ids: IntArray,
    sensor: Sensor,
    conditions: Conditions,
    keys: Keys,
    scene: Scene,
    frames: Frames,
) -> None:
    """Fill the rings of starting trials with the scene before time zero.

    A target that was there is seen by eyes at rest; one that was not leaves no frames at all.

    Args:
        ids: (m,) the trials that start.
        sensor: `bare`, see `vergence.envs.plants.sensing.sense`, as are the following four.
        conditions: what the trials run with.
        keys: those of the trials' random numbers.
        scene: what there is to see.
        frames: the rings, filled.
    """
    sensor, conditions, keys = Sensor(*sensor), Conditions(*conditions), Keys(*keys)
    scene, frames = Scene(*scene), Frames(*frames)
    ring = frames.arrived.shape[1]
    for n in ids:
        p, motion = head_of(scene, n), motion_of(scene.motions[n])
        for k in range(-ring, 0):
            slot = k % ring
            noise = pixel_noise(keys, n, _BEFORE, -k, conditions.detection_noise_px[n])
            frames.arrived[n, slot] = motion.seen_before and k % sensor.periods_per_frame == 0
            for eye in range(2):
                u, v = eye_pixel(p, eye, scene.positions[n], motion.before)
                frames.visible[n, slot, eye] = inside_image(p, eye, u, v)
                frames.pixels[n, slot, eye, 0] = u + noise[2 * eye]
                frames.pixels[n, slot, eye, 1] = v + noise[2 * eye + 1]

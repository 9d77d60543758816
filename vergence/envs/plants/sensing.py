r"""The sensor model of every simulated plant: exposure, noise, delay, drops, quantisation.

Step k of a trial is the time `k T`. `expose` takes the frame whose middle is at that time and
puts what the detector makes of it into a ring; `report` gives out the newest frame that has had
its latency, with the joint angles of the same instant. A frame that is dropped is never read,
so the one before it grows older.

A reading dates its image by the nominal latency, as a robot does that knows when an image
arrived. Where a plant's own latency differs, the angles "at exposure" are those of the date in
the reading, and the error is the controller's to bear.
"""

from math import hypot, nan
from typing import Final, NamedTuple

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.plants.conditions import Conditions
from vergence.envs.plants.motors import Motors, feel_angles, feel_speeds, quantise
from vergence.envs.plants.scene import (
    Place,
    Scene,
    eye_pixel,
    image_motion,
    target_in_n,
)
from vergence.envs.reading import BoolArray, Reading
from vergence.envs.streams import IntArray, Keys, Purpose, random_words, to_normals, to_uniform
from vergence.envs.targets.motion import motion_of
from vergence.models.camera import inside_image
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_SENSOR: Final = int(Purpose.SENSOR)


class Sensor(NamedTuple):
    """The clock and the sensors that a batch of heads has in common."""

    period_s: float
    """The control period."""
    periods_per_frame: int
    """Control periods from frame to frame."""
    latency: int
    """The latency by which a reading dates its image, control periods."""
    exposure_s: float
    """How long the shutter is open."""
    max_smear_px: float
    """Motion in the image during an exposure beyond which the target is not seen."""
    angle_step_rad: float
    """Resolution of the joint angles where each joint has its own motor; 0 for exact."""
    speed_step_rad_s: float
    """Resolution of the joint velocities, the same."""

    @classmethod
    def of(cls, head: HeadModel) -> "Sensor":
        """Those of a head."""
        timing, sensor = head.timing, head.sensor
        return cls(
            period_s=timing.period_s,
            periods_per_frame=timing.periods_per_frame,
            latency=timing.latency_frames,
            exposure_s=timing.exposure_s,
            max_smear_px=sensor.max_smear_px,
            angle_step_rad=sensor.encoder_resolution_rad,
            speed_step_rad_s=sensor.velocity_resolution_rad_s,
        )


class Frames(NamedTuple):
    """The frames and the joint angles of the last steps: step k lies at k modulo the ring."""

    pixels: FloatArray
    """(n, ring, 2, 2) what the detector made of both eyes' frames, px."""
    visible: BoolArray
    """(n, ring, 2) whether it saw the target."""
    arrived: BoolArray
    """(n, ring) whether there is a frame."""
    angles: FloatArray
    """(n, ring, 7) joint angles as read, rad."""

    @classmethod
    def empty(cls, num: int, ring: int) -> "Frames":
        """Rings without frames."""
        return cls(
            pixels=np.zeros((num, ring, 2, 2)),
            visible=np.zeros((num, ring, 2), dtype=np.bool_),
            arrived=np.zeros((num, ring), dtype=np.bool_),
            angles=np.zeros((num, ring, 7)),
        )


@device
def pixel_noise(
    keys: Keys, n: Place, purpose: int, block: int, sigma: float
) -> tuple[float, float, float, float]:
    """The detections' errors in one pair of frames: u and v left, u and v right."""
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    words = random_words(keys.seeds[n], keys.trials[n], purpose, block, 1)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


@device
def _is_dropped(keys: Keys, n: Place, step: int, probability: float) -> bool:
    if probability == 0.0:
        return False
    words = random_words(keys.seeds[n], keys.trials[n], _SENSOR, step, 2)
    return to_uniform(words[0]) < probability


@compiled
def expose(
    ids: IntArray,
    sensor: Sensor,
    conditions: Conditions,
    keys: Keys,
    scene: Scene,
    frames: Frames,
) -> None:
    """Take the frames of some places' present step into their rings, see `sense`."""
    # taken out of their groups once: in the loop, numba counts references at each access
    heads, motions, necks, steps, positions, _velocities = scene
    pixels, visible, arrived, _angles = frames
    drop, noise_px = conditions.dropped_frame_probability, conditions.detection_noise_px
    ring, many = arrived.shape[1], np.uintp(heads.shape[0] > 1)
    for place in ids:
        n = np.uintp(place)  # unsigned, so that no index is counted from the end
        k = steps[n]
        slot = np.uintp(k % ring)
        taken = k % sensor.periods_per_frame == 0 and not _is_dropped(keys, n, k, drop[n])
        arrived[n, slot] = taken
        if taken:
            p, q = heads[n * many], positions[n]
            motion = motion_of(motions[n])
            point = target_in_n(p, motion, necks[n], q, k * sensor.period_s)
            lu, lv = eye_pixel(p, 0, q, point)
            ru, rv = eye_pixel(p, 1, q, point)
            left, right = inside_image(p, 0, lu, lv), inside_image(p, 1, ru, rv)
            visible[n, slot, 0], visible[n, slot, 1] = left, right
            if left | right:
                noise = pixel_noise(keys, n, _SENSOR, k, noise_px[n])
                pixels[n, slot, 0, 0] = lu + noise[0]
                pixels[n, slot, 0, 1] = lv + noise[1]
                pixels[n, slot, 1, 0] = ru + noise[2]
                pixels[n, slot, 1, 1] = rv + noise[3]


@compiled
def smear(ids: IntArray, sensor: Sensor, scene: Scene, frames: Frames) -> None:
    """Make targets invisible that move too far while the shutter is open, see `sense`."""
    ring, half_s = frames.arrived.shape[1], 0.5 * sensor.exposure_s
    for n in ids:
        k = scene.step[n]
        slot = k % ring
        if frames.arrived[n, slot]:
            for eye in range(2):
                if frames.visible[n, slot, eye]:
                    du, dv = image_motion(scene, n, eye, k * sensor.period_s, half_s)
                    frames.visible[n, slot, eye] = hypot(du, dv) <= sensor.max_smear_px


@compiled
def report(
    ids: IntArray,
    sensor: Sensor,
    conditions: Conditions,
    scene: Scene,
    frames: Frames,
    reading: Reading,
    motors: Motors | None,
) -> None:
    """Give out the newest readable frames and the joints' feedback, see `sense`."""
    _heads, _motions, _necks, steps, positions, velocities = scene
    pixels, visible, arrived, angles = frames
    latency = conditions.latency_frames
    ring = arrived.shape[1]
    for place in ids:
        n = np.uintp(place)
        k = steps[n]
        slot = np.uintp(k % ring)
        reading.time_s[n] = k * sensor.period_s
        if motors is None:
            for j in range(7):
                angle = quantise(positions[n, j], sensor.angle_step_rad)
                reading.positions[n, j] = angles[n, slot, j] = angle
                reading.velocities[n, j] = quantise(velocities[n, j], sensor.speed_step_rad_s)
        else:
            feel_angles(motors, n, reading.positions[n])
            feel_speeds(motors, n, reading.velocities[n])
            for j in range(7):
                angles[n, slot, j] = reading.positions[n, j]
        newest = np.uintp((k - latency[n]) % ring)
        if not arrived[n, newest]:
            continue
        dated = k - sensor.latency
        then = np.uintp(dated % ring)
        reading.frame[n] += 1
        reading.exposure_s[n] = dated * sensor.period_s
        reading.received_s[n] = k * sensor.period_s
        for j in range(7):
            reading.positions_at_exposure[n, j] = angles[n, then, j]
        for eye in range(2):
            seen = visible[n, newest, eye]
            reading.visible[n, eye] = seen
            reading.pixels[n, eye, 0] = pixels[n, newest, eye, 0] if seen else nan
            reading.pixels[n, eye, 1] = pixels[n, newest, eye, 1] if seen else nan


@compiled
def sense(
    ids: IntArray,
    sensor: Sensor,
    conditions: Conditions,
    keys: Keys,
    scene: Scene,
    frames: Frames,
    reading: Reading,
    motors: Motors | None,
) -> None:
    """Take the present frames of some places, and read their sensors.

    Args:
        ids: (m,) the places whose eyes look.
        sensor: `bare`, as are the following five.
        conditions: what the trials run with.
        keys: those of the trials' random numbers.
        scene: what there is to see.
        frames: the rings, brought up to date.
        reading: the result; it keeps its values where no new frame came.
        motors: `bare`, of heads that have other motors than one a joint.
    """
    sensor, conditions, keys = Sensor(*sensor), Conditions(*conditions), Keys(*keys)
    scene, frames, reading = Scene(*scene), Frames(*frames), Reading(*reading)
    # a loop each: one loop for all three takes twice as long
    expose(ids, sensor, conditions, keys, scene, frames)
    if sensor.exposure_s > 0.0:
        smear(ids, sensor, scene, frames)
    if motors is None:
        report(ids, sensor, conditions, scene, frames, reading, None)
    else:
        report(ids, sensor, conditions, scene, frames, reading, Motors(*motors))


@compiled
def read(
    ids: IntArray,
    sensor: Sensor,
    conditions: Conditions,
    scene: Scene,
    frames: Frames,
    reading: Reading,
    motors: Motors | None,
) -> None:
    """Read the sensors of some places whose frames are in their rings already, see `sense`."""
    sensor, conditions = Sensor(*sensor), Conditions(*conditions)
    scene, frames, reading = Scene(*scene), Frames(*frames), Reading(*reading)
    if motors is None:
        report(ids, sensor, conditions, scene, frames, reading, None)
    else:
        report(ids, sensor, conditions, scene, frames, reading, Motors(*motors))

"""How trials of a simulated plant start: joints at rest, sensors that saw the time before zero."""

from math import nan
from typing import Any, Final

from vergence._jit import compiled
from vergence.envs.philox import Purpose
from vergence.envs.plants.scene import eye_pixel
from vergence.envs.plants.sensing import pixel_noise, quantise
from vergence.envs.targets.motion import SEEN_BEFORE
from vergence.models.camera import inside_image

_BEFORE: Final = int(Purpose.BEFORE)


@compiled
def begin(
    ids: Any, positions: Any, motions: Any, angle_step: float, q: Any, v: Any, command: Any,
    necks: Any, rows: Any, step: Any, frame_arrived: Any, angles: Any, pixels: Any, visible: Any,
    exposure_s: Any, received_s: Any, at_exposure: Any,
) -> bool:  # fmt: skip
    """Bring starting trials to time zero, their joints at rest and their rings empty.

    Args:
        ids: (m,) the trials that start.
        positions: (m, 7) where their joints are, rad.
        motions: (m, MOTION) their targets.
        angle_step: see `vergence.envs.plants.sensing.read`, as are the rest.
        q: (n, 7).
        v: (n, 7).
        command: (n, 7) the commands that hold, rad/s.
        necks: (n, 3) the neck's angles at the trials' start, rad.
        rows: (n, MOTION) the targets.
        step: (n,).
        frame_arrived: (n, ring).
        angles: (n, ring, 7).
        pixels: (n, 2, 2).
        visible: (n, 2).
        exposure_s: (n,).
        received_s: (n,).
        at_exposure: (n, 7).

    Returns:
        Whether some target was there before time zero.
    """
    seen_before = False
    for m in range(ids.shape[0]):
        n = ids[m]
        rows[n] = motions[m]
        seen_before = seen_before or motions[m, SEEN_BEFORE] != 0.0
        step[n] = 0
        for j in range(7):
            q[n, j] = positions[m, j]
            v[n, j] = command[n, j] = 0.0
            at_exposure[n, j] = quantise(positions[m, j], angle_step)
            angles[n, :, j] = at_exposure[n, j]
        necks[n] = positions[m, :3]
        frame_arrived[n] = False
        visible[n] = False
        pixels[n] = nan
        exposure_s[n] = received_s[n] = nan
    return seen_before


@compiled
def expose_before(
    heads: Any, rows: Any, necks: Any, q: Any, ids: Any, noise_px: Any, seeds: Any,
    trials: Any, periods_per_frame: int, frame_pixels: Any, frame_visible: Any,
    frame_arrived: Any,
) -> None:  # fmt: skip
    """Fill the rings of starting trials with the scene before time zero.

    A target that was there is seen by eyes at rest; one that was not leaves no frames at all.

    Args:
        heads: (n or 1, PACKED) the true heads.
        rows: (n, MOTION) the targets.
        necks: (n, 3) the neck's angles at the trials' start, rad.
        q: (n, 7) true joint angles, rad.
        ids: (m,) the trials that start.
        noise_px: (n,) standard deviation of the detection, px.
        seeds: (n,) keys of the trials' random numbers.
        trials: (n,) keys of the trials' random numbers.
        periods_per_frame: steps from frame to frame.
        frame_pixels: (n, ring, 2, 2) the rings' pixels.
        frame_visible: (n, ring, 2) the rings' visibility.
        frame_arrived: (n, ring) whether there is a frame.
    """
    ring = frame_arrived.shape[1]
    for n in ids:
        p = heads[n if heads.shape[0] > 1 else 0]
        for k in range(-ring, 0):
            slot = k % ring
            noise = pixel_noise(seeds[n], trials[n], _BEFORE, -k, noise_px[n])
            frame_arrived[n, slot] = rows[n, SEEN_BEFORE] != 0.0 and k % periods_per_frame == 0
            point = (rows[n, 0], rows[n, 1], rows[n, 2])
            for eye in range(2):
                pu, pv = eye_pixel(p, eye, q[n], point)
                frame_visible[n, slot, eye] = inside_image(p, eye, pu, pv)
                frame_pixels[n, slot, eye, 0] = pu + noise[2 * eye]
                frame_pixels[n, slot, eye, 1] = pv + noise[2 * eye + 1]

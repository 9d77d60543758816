r"""The sensor model of every simulated plant: exposure, noise, delay, drops, quantisation.

Step k of a trial is the time `k T`. `expose` takes the frame whose middle is at that time and
puts what the detector makes of it into a ring; `read` gives out the newest frame that has had
its latency, with the joint angles of the same instant. A frame that is dropped is never read,
so the one before it grows older.

A reading dates its image by the nominal latency, as a robot does that knows when an image
arrived. Where a plant's own latency differs, the angles "at exposure" are those of the date in
the reading, and the error is the controller's to bear.
"""

from math import hypot, nan
from typing import Any, Final

import numpy as np

from vergence._jit import compiled, device
from vergence.envs.philox import Purpose, random_words, to_normals, to_uniform
from vergence.envs.plants.scene import eye_pixel, image_motion, target_in_n
from vergence.models.camera import inside_image

_SENSOR: Final = int(Purpose.SENSOR)


@device
def pixel_noise(seed: Any, trial: Any, purpose: int, block: int, sigma: float) -> Any:
    """The detections' errors in one pair of frames: u and v left, u and v right."""
    if sigma == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    words = random_words(seed, trial, purpose, block, 1)
    a, b = to_normals(words[0], words[1])
    c, d = to_normals(words[2], words[3])
    return sigma * a, sigma * b, sigma * c, sigma * d


@device
def _is_dropped(seed: Any, trial: Any, step: int, probability: float) -> Any:
    if probability == 0.0:
        return False
    return to_uniform(random_words(seed, trial, _SENSOR, step, 2)[0]) < probability


@compiled
def expose(
    ids: Any, heads: Any, rows: Any, necks: Any, q: Any, step: Any, period: float,
    periods_per_frame: int, noise_px: Any, drop: Any, seeds: Any, trials: Any,
    frame_pixels: Any, frame_visible: Any, frame_arrived: Any,
) -> None:  # fmt: skip
    """Take the frames of the present step into the rings.

    Args:
        ids: (m,) the places whose eyes look.
        heads: (n or 1, PACKED) the true heads.
        rows: (n, MOTION) the targets.
        necks: (n, 3) the neck's angles at the trials' start, rad.
        q: (n, 7) true joint angles, rad.
        step: (n,) steps since the trials' start.
        period: control period, s.
        periods_per_frame: steps from frame to frame.
        noise_px: (n,) standard deviation of the detection, px.
        drop: (n,) probability that a frame is dropped.
        seeds: (n,) keys of the trials' random numbers.
        trials: (n,) keys of the trials' random numbers.
        frame_pixels: (n, ring, 2, 2) the rings' pixels.
        frame_visible: (n, ring, 2) the rings' visibility.
        frame_arrived: (n, ring) whether there is a frame.
    """
    ring = frame_arrived.shape[1]
    many = np.uintp(heads.shape[0] > 1)
    for place in ids:
        n = np.uintp(place)  # unsigned, so that no index is counted from the end
        k = step[n]
        slot = np.uintp(k % ring)
        arrived = k % periods_per_frame == 0 and not _is_dropped(seeds[n], trials[n], k, drop[n])
        frame_arrived[n, slot] = arrived
        if arrived:
            p = heads[n * many]
            point = target_in_n(p, rows[n], necks[n], q[n], k * period)
            lu, lv = eye_pixel(p, 0, q[n], point)
            ru, rv = eye_pixel(p, 1, q[n], point)
            left, right = inside_image(p, 0, lu, lv), inside_image(p, 1, ru, rv)
            frame_visible[n, slot, 0], frame_visible[n, slot, 1] = left, right
            if left | right:
                noise = pixel_noise(seeds[n], trials[n], _SENSOR, k, noise_px[n])
                frame_pixels[n, slot, 0, 0] = lu + noise[0]
                frame_pixels[n, slot, 0, 1] = lv + noise[1]
                frame_pixels[n, slot, 1, 0] = ru + noise[2]
                frame_pixels[n, slot, 1, 1] = rv + noise[3]


@compiled
def smear(
    ids: Any, heads: Any, rows: Any, necks: Any, q: Any, v: Any, step: Any, period: float,
    exposure: float, max_smear: float, frame_visible: Any, frame_arrived: Any,
) -> None:  # fmt: skip
    """Make targets invisible in the present frames that move too far while the shutter is open.

    Args:
        ids: see `expose`, as are `heads` to `period`.
        heads: (n or 1, PACKED).
        rows: (n, MOTION).
        necks: (n, 3).
        q: (n, 7).
        v: (n, 7) true joint velocities, rad/s.
        step: (n,).
        period: s.
        exposure: how long the shutter is open, s.
        max_smear: motion in the image beyond which the target is not seen, px.
        frame_visible: (n, ring, 2) the rings' visibility.
        frame_arrived: (n, ring) whether there is a frame.
    """
    ring, half = frame_arrived.shape[1], 0.5 * exposure
    for n in ids:
        k = step[n]
        if frame_arrived[n, k % ring]:
            p = heads[n] if heads.shape[0] > 1 else heads[0]
            for eye in range(2):
                if frame_visible[n, k % ring, eye]:
                    du, dv = image_motion(p, eye, q[n], v[n], rows[n], necks[n], k * period, half)
                    frame_visible[n, k % ring, eye] = hypot(du, dv) <= max_smear


@device
def quantise(value: float, step: float) -> float:
    """A value as a sensor of some resolution reports it; 0 for exact."""
    return step * np.round(value / step) if step > 0.0 else value


@compiled
def read(
    ids: Any, q: Any, v: Any, step: Any, period: float, latency: Any, nominal_latency: int,
    angle_step: float, speed_step: float, frame_pixels: Any, frame_visible: Any,
    frame_arrived: Any, angles: Any, time_s: Any, pixels: Any, visible: Any, exposure_s: Any,
    received_s: Any, at_exposure: Any, positions: Any, velocities: Any,
) -> None:  # fmt: skip
    """Give out the newest readable frames and the joints' feedback.

    Args:
        ids: (m,) the places to do.
        q: (n, 7) true joint angles, rad.
        v: (n, 7) true joint velocities, rad/s.
        step: (n,) steps since the trials' start.
        period: control period, s.
        latency: (n,) steps from exposure to reading.
        nominal_latency: the latency by which a reading dates its image, steps.
        angle_step: resolution of the joint angles, rad; 0 for exact.
        speed_step: resolution of the joint velocities, rad/s; 0 for exact.
        frame_pixels: (n, ring, 2, 2) the rings' pixels.
        frame_visible: (n, ring, 2) the rings' visibility.
        frame_arrived: (n, ring) whether there is a frame.
        angles: (n, ring, 7) the ring of joint angles as read, rad.
        time_s: see `Reading`, as are the rest; they keep their values where no new frame came.
        pixels: (n, 2, 2).
        visible: (n, 2).
        exposure_s: (n,).
        received_s: (n,).
        at_exposure: (n, 7).
        positions: (n, 7).
        velocities: (n, 7).
    """
    ring = frame_arrived.shape[1]
    for place in ids:
        n = np.uintp(place)
        k = step[n]
        slot = np.uintp(k % ring)
        time_s[n] = k * period
        for j in range(7):
            positions[n, j] = angles[n, slot, j] = quantise(q[n, j], angle_step)
            velocities[n, j] = quantise(v[n, j], speed_step)
        frame = np.uintp((k - latency[n]) % ring)
        if not frame_arrived[n, frame]:
            continue
        dated = k - nominal_latency
        then = np.uintp(dated % ring)
        exposure_s[n], received_s[n] = dated * period, k * period
        for j in range(7):
            at_exposure[n, j] = angles[n, then, j]
        for eye in range(2):
            seen = frame_visible[n, frame, eye]
            visible[n, eye] = seen
            pixels[n, eye, 0] = frame_pixels[n, frame, eye, 0] if seen else nan
            pixels[n, eye, 1] = frame_pixels[n, frame, eye, 1] if seen else nan

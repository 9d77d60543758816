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
from vergence.envs.motion import SEEN_BEFORE, position_at
from vergence.envs.philox import Purpose, random_words, to_normals, to_uniform
from vergence.models.camera import inside_image, point_to_pixel, undistort_pixel
from vergence.models.kinematics import (
    CAMERA_STRIDE,
    CAMERAS,
    into,
    neck_frame,
    out_of,
    point_in_eye,
)

_SENSOR: Final = int(Purpose.SENSOR)
_BEFORE: Final = int(Purpose.BEFORE)


@device
def target_in_n(p: Any, row: Any, anchor_neck: Any, q: Any, t: float) -> Any:
    """The target in the present N: it belongs to the world, N to the neck."""
    x, y, z = position_at(row, t)
    if q[0] == anchor_neck[0] and q[1] == anchor_neck[1] and q[2] == anchor_neck[2]:
        return x, y, z
    start = neck_frame(p, anchor_neck[0], anchor_neck[1], anchor_neck[2])
    x, y, z = out_of(start, x, y, z)
    return into(neck_frame(p, q[0], q[1], q[2]), x, y, z)


@device
def _eye_pixel(p: Any, eye: int, q: Any, point: Any) -> Any:
    x, y, z = point_in_eye(p, eye, q[3 + 2 * eye], q[4 + 2 * eye], point[0], point[1], point[2])
    return point_to_pixel(p, eye, x, y, z, True)


@device
def image_motion(
    p: Any, eye: int, q: Any, v: Any, row: Any, neck: Any, t: float, half: float
) -> Any:
    """How far the target's image moves while the shutter is open.

    A jump is no motion: the frame shows where the target is in the middle of the exposure, so
    the first frame at or after a jump shows it after the jump, sharp.
    """
    tilt, pan = q[3 + 2 * eye], q[4 + 2 * eye]
    dt, dp = v[3 + 2 * eye] * half, v[4 + 2 * eye] * half
    y, r, n = v[0] * half, v[1] * half, v[2] * half
    jump = row[16]
    begin = max(t - half, jump) if t >= jump else t - half
    end = t + half if t >= jump or t + half < jump else t
    ax, ay, az = target_in_n(p, row, neck, (q[0] - y, q[1] - r, q[2] - n), begin)
    bx, by, bz = target_in_n(p, row, neck, (q[0] + y, q[1] + r, q[2] + n), end)
    x, y, z = point_in_eye(p, eye, tilt - dt, pan - dp, ax, ay, az)
    ua, va = point_to_pixel(p, eye, x, y, z, True)
    x, y, z = point_in_eye(p, eye, tilt + dt, pan + dp, bx, by, bz)
    ub, vb = point_to_pixel(p, eye, x, y, z, True)
    return ub - ua, vb - va


@device
def _pixel_noise(seed: Any, trial: Any, purpose: int, block: int, sigma: float) -> Any:
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
            lu, lv = _eye_pixel(p, 0, q[n], point)
            ru, rv = _eye_pixel(p, 1, q[n], point)
            left, right = inside_image(p, 0, lu, lv), inside_image(p, 1, ru, rv)
            frame_visible[n, slot, 0], frame_visible[n, slot, 1] = left, right
            if left | right:
                noise = _pixel_noise(seeds[n], trials[n], _SENSOR, k, noise_px[n])
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
            noise = _pixel_noise(seeds[n], trials[n], _BEFORE, -k, noise_px[n])
            frame_arrived[n, slot] = rows[n, SEEN_BEFORE] != 0.0 and k % periods_per_frame == 0
            point = (rows[n, 0], rows[n, 1], rows[n, 2])
            for eye in range(2):
                pu, pv = _eye_pixel(p, eye, q[n], point)
                frame_visible[n, slot, eye] = inside_image(p, eye, pu, pv)
                frame_pixels[n, slot, eye, 0] = pu + noise[2 * eye]
                frame_pixels[n, slot, eye, 1] = pv + noise[2 * eye + 1]


@device
def _quantise(value: float, step: float) -> float:
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
            positions[n, j] = angles[n, slot, j] = _quantise(q[n, j], angle_step)
            velocities[n, j] = _quantise(v[n, j], speed_step)
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
        angle_step: see `read`, as are the rest.
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
            at_exposure[n, j] = _quantise(positions[m, j], angle_step)
            angles[n, :, j] = at_exposure[n, j]
        necks[n] = positions[m, :3]
        frame_arrived[n] = False
        visible[n] = False
        pixels[n] = nan
        exposure_s[n] = received_s[n] = nan
    return seen_before


@compiled
def look(
    heads: Any, nominal: Any, rows: Any, necks: Any, q: Any, step: Any, period: float,
    target: Any, pixels: Any, error: Any, inside: Any,
) -> None:  # fmt: skip
    """What the eyes would see at present without delay and noise, see `Truth`.

    Args:
        heads: (n or 1, PACKED) the true heads.
        nominal: (PACKED,) the head that the controller knows.
        rows: (n, MOTION) the targets.
        necks: (n, 3) the neck's angles at the trials' start, rad.
        q: (n, 7) true joint angles, rad.
        step: (n,) steps since the trials' start.
        period: control period, s.
        target: (n, 3) result, m.
        pixels: (n, 2, 2) result.
        error: (n, 2, 2) result.
        inside: (n, 2) result.
    """
    for n in range(q.shape[0]):
        p = heads[n if heads.shape[0] > 1 else 0]
        point = target_in_n(p, rows[n], necks[n], q[n], step[n] * period)
        target[n, 0], target[n, 1], target[n, 2] = point
        for eye in range(2):
            i = CAMERAS + eye * CAMERA_STRIDE
            pu, pv = _eye_pixel(p, eye, q[n], point)
            inside[n, eye] = inside_image(p, eye, pu, pv)
            pixels[n, eye, 0], pixels[n, eye, 1] = pu, pv
            iu, iv = undistort_pixel(nominal, eye, pu, pv)
            error[n, eye, 0], error[n, eye, 1] = iu - nominal[i + 2], iv - nominal[i + 3]

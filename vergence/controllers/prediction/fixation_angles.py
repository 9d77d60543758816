r"""Each eye joint's goal: measured in an image, filtered from image to image.

An image's goals are the angles that put its target, triangulated from the pixels and the angles
of its exposure, on the optical axes. Each joint's goal is filtered by a scalar Kalman filter. A
measurement's variance is that of the pixels, of the encoders while the joint moves, of the
head's model (a share of the angle to turn), and the square of what the plausible delays make of
it; so a resting eye averages noise, and an image that was exposed in motion counts for little
until its delay is known. A goal far outside its variance has jumped, or moves: the filter then
begins anew from the measurement.
"""

from math import isfinite, nan
from typing import Any, Final

from vergence._jit import device
from vergence.controllers.prediction import delay as bank
from vergence.controllers.prediction.delay import (
    IMAGE,
    RING,
    dating_error,
    least_misfit,
    likely_delay,
    remember_dates,
    remember_turn,
    weigh_delays,
)
from vergence.controllers.prediction.joints import ANGLE_STEP, LOWER, PIXEL_SIGMA, UPPER
from vergence.controllers.prediction.memory import (
    ANGLES,
    COUNT,
    DELAY,
    DEPTH,
    GOALS,
    IMAGES,
    MISFIT,
    NOISE,
    RANGE,
    SIZE,
    STILL,
    VARIANCE,
)
from vergence.models.fixation import fixate_step
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import camera_of
from vergence.models.pose import into, out_of
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image

_MODEL: Final = 0.005
"""Share of the angle to turn that the head's model leaves uncertain."""
_ENCODER: Final = 0.3
"""What tracking leaves of an encoder's step while the joint moves."""
_PROCESS: Final = 0.05
"""How much a goal may wander from image to image, as a share of the pixels' variance."""
_GATE: Final = 9.0
"""Square of the innovation, by its variance, beyond which a goal has jumped."""
_NOISE_SHARE: Final = 0.1
_NEWTON: Final = 10


@device
def _measure(row: Any, error: Any, rig: Any, p: Any, image: Any) -> None:
    """The goals of a fresh image, from the angles at its exposure."""
    count, delay = int(row[COUNT]) - 1, int(row[DELAY])
    ring = row[ANGLES:IMAGES]
    then = 4 * ((count - delay) % RING)
    cl = eye_frames(p, 0, ring[then], ring[then + 1])[2]
    cr = eye_frames(p, 1, ring[then + 2], ring[then + 3])[2]
    left, right = rays_of_image(p, cl, cr, error)
    depth_l, depth_r, found = depths_on_rays(left, right)
    # one eye alone keeps the depth that both saw last
    if found:
        row[DEPTH], row[DEPTH + 1] = depth_l, depth_r
    for eye in range(2):
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            image[bank.GOAL + 2 * eye] = image[bank.GOAL + 2 * eye + 1] = nan
            continue
        z = row[DEPTH + eye]
        o, d = left if eye == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        tilt, pan = ring[then + 2 * eye], ring[then + 2 * eye + 1]
        if isfinite(row[GOALS + 2 * eye]):  # Newton's method from the last goal needs one step
            tilt, pan = row[GOALS + 2 * eye], row[GOALS + 2 * eye + 1]
        for _ in range(_NEWTON):
            dt, dp = fixate_step(p, eye, tilt, pan, x, y, z)
            tilt += min(max(dt, -0.5), 0.5)
            pan += min(max(dp, -0.5), 0.5)
            if abs(dt) + abs(dp) < 1e-4:  # what is left is its square
                break
        image[bank.GOAL + 2 * eye], image[bank.GOAL + 2 * eye + 1] = tilt, pan
        row[RANGE + eye] = into(eye_frames(p, eye, tilt, pan)[2], x, y, z)[2]
        remember_turn(image, tilt - ring[then + 2 * eye], pan, eye)
    remember_dates(image, ring, count, delay)


@device
def _learn_delay(row: Any, new: Any, rig: Any) -> None:
    """Weigh the delays by a new image, and date it by the best."""
    ring, misfit = row[ANGLES:IMAGES], row[MISFIT:SIZE]
    old = row[IMAGES + IMAGE : IMAGES + 2 * IMAGE]
    older = row[IMAGES + 2 * IMAGE : MISFIT]
    noise = weigh_delays(misfit, ring, new, old, older, rig, row[NOISE], row[STILL] >= RING)
    if noise >= 0.0:
        # a jump is no noise
        noise = min(noise, 16.0 * row[NOISE])
        row[NOISE] += _NOISE_SHARE * (noise - row[NOISE])
        row[NOISE] = max(row[NOISE], rig[PIXEL_SIGMA] ** 2)
    row[DELAY] = new[bank.DATED] = likely_delay(misfit, rig)


@device
def _filter(row: Any, image: Any, rig: Any, uncertain: bool) -> None:
    """Take a new image's goals into the filtered ones."""
    count, delay = int(row[COUNT]) - 1, int(row[DELAY])
    ring, misfit = row[ANGLES:IMAGES], row[MISFIT:SIZE]
    then, now = 4 * ((count - delay) % RING), 4 * (count % RING)
    least = least_misfit(misfit) if uncertain else 0.0
    pixel = row[NOISE]
    for eye in range(2):
        a = 2 * eye
        if not isfinite(image[bank.GOAL + a]):
            continue
        begins = not isfinite(row[GOALS + a])
        goals = bank.dated(image, ring, delay, eye)
        datings = (0.0, 0.0)
        if uncertain:
            datings = dating_error(misfit, least, ring, image, eye)
        for j in range(a, a + 2):
            goal, dating = goals[j - a], datings[j - a]
            encoder = 0.0
            if abs(ring[now + j] - ring[then + j]) > 0.25 * rig[ANGLE_STEP]:
                encoder = _ENCODER * rig[ANGLE_STEP]
            model = _MODEL * (goal - ring[then + j])
            variance = pixel + encoder * encoder + model * model + dating * dating
            before = row[VARIANCE + j] + _PROCESS * pixel
            innovation = goal - row[GOALS + j]
            if begins:
                row[GOALS + j], row[VARIANCE + j] = goal, variance
                continue
            if innovation * innovation > _GATE * (before + variance):
                before += innovation * innovation
            gain = before / (before + variance)
            row[GOALS + j] += gain * innovation
            row[VARIANCE + j] = (1.0 - gain) * before


@device
def take_image(row: Any, error: Any, rig: Any, p: Any, learn: bool) -> None:
    """Take a new image into the goals, and remember it."""
    new = row[IMAGES : IMAGES + IMAGE]
    _measure(row, error, rig, p, new)
    if learn:
        _learn_delay(row, new, rig)
    _filter(row, new, rig, learn)
    for i in range(IMAGE):
        row[IMAGES + 2 * IMAGE + i] = row[IMAGES + IMAGE + i]
        row[IMAGES + IMAGE + i] = new[i]


@device
def present_of(row: Any, rig: Any, p: Any, eye: int, tilt: float, pan: float) -> Any:
    """What one eye still has to turn, and its pixel error, at its present angles.

    Args:
        row: what is remembered of the head.
        rig: see `vergence.controllers.prediction.joints.joint_rig`.
        p: a packed head.
        eye: which one.
        tilt: its present tilt, rad.
        pan: its present pan, rad.

    Returns:
        Tilt and pan to turn, rad, 0 where the target is not known; and the undistorted pixel
        error along u and v, px, nan where it is not known.
    """
    t = GOALS + 2 * eye
    goal_tilt, goal_pan = row[t], row[t + 1]
    if not isfinite(goal_tilt):
        return 0.0, 0.0, nan, nan
    # the point that is on the axis when the eye has turned there
    camera = eye_frames(p, eye, goal_tilt, goal_pan)[2]
    px, py, pz = out_of(camera, 0.0, 0.0, row[RANGE + eye])
    x, y, z = point_in_eye(p, eye, tilt, pan, px, py, pz)
    u = v = nan
    if z > 0.0:
        lens = camera_of(p, eye)
        u, v = lens.focal_u * x / z, lens.focal_v * y / z
    a = 2 * eye
    goal_tilt = min(max(goal_tilt, rig[LOWER + a]), rig[UPPER + a])
    goal_pan = min(max(goal_pan, rig[LOWER + a + 1]), rig[UPPER + a + 1])
    return goal_tilt - tilt, goal_pan - pan, u, v

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
from typing import Final

from vergence._jit import device
from vergence.controllers.prediction.delay import (
    dated,
    dating_error,
    least_misfit,
    likely_delay,
    remember_dates,
    remember_turn,
    weigh_delays,
)
from vergence.controllers.prediction.joints import Rig
from vergence.controllers.prediction.memory import RING, Memory, place
from vergence.models.fixation import fixate_step
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, camera_of
from vergence.models.parts import FloatArray
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
def _measure(memory: Memory, rig: Rig, error: FloatArray, p: PackedHead) -> None:
    """The goals of a fresh image, from the angles at its exposure."""
    image, then = memory.images[0], memory.angles[place(memory.count, memory.delay)]
    left, right = rays_of_image(
        p,
        eye_frames(p, 0, then[0, 0], then[0, 1]).camera,
        eye_frames(p, 1, then[1, 0], then[1, 1]).camera,
        error,
    )
    depths = depths_on_rays(left, right)
    # one eye alone keeps the depth that both saw last
    if depths.found:
        memory.depth[0], memory.depth[1] = depths.left, depths.right
    for eye in range(2):
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            image.goals[eye, 0] = image.goals[eye, 1] = nan
            continue
        z = memory.depth[eye]
        o, d = left if eye == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = then[eye, 0], then[eye, 1]
        if isfinite(memory.goals[eye, 0]):  # Newton's method from the last goal needs one step
            q1, q2 = memory.goals[eye, 0], memory.goals[eye, 1]
        for _ in range(_NEWTON):
            d1, d2 = fixate_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # what is left is its square
                break
        image.goals[eye, 0], image.goals[eye, 1] = q1, q2
        frames = eye_frames(p, eye, q1, q2)
        memory.fixated_depth[eye] = into(frames.camera, x, y, z)[2]
        remember_turn(image, rig, eye, q1 - then[eye, 0], image.goals[eye], frames)
    remember_dates(image, memory.angles, memory.count, memory.delay)


@device
def _learn_delay(memory: Memory, rig: Rig) -> None:
    """Weigh the delays by a new image, and date it by the best."""
    noise = weigh_delays(memory, rig, memory.still >= RING)
    if noise >= 0.0:
        # a jump is no noise
        noise = min(noise, 16.0 * memory.noise)
        memory.noise += _NOISE_SHARE * (noise - memory.noise)
        memory.noise = max(memory.noise, rig.pixel_rad**2)
    memory.delay = memory.images[0].delay = likely_delay(memory.misfit, rig)


@device
def _filter(memory: Memory, rig: Rig, uncertain: bool) -> None:
    """Take a new image's goals into the filtered ones."""
    image = memory.images[0]
    then = memory.angles[place(memory.count, memory.delay)]
    now = memory.angles[place(memory.count, 0.0)]
    least = least_misfit(memory.misfit) if uncertain else 0.0
    pixel = memory.noise
    for eye in range(2):
        if not isfinite(image.goals[eye, 0]):
            continue
        begins = not isfinite(memory.goals[eye, 0])
        goals = dated(image, memory.angles, memory.delay, eye)
        datings = dating_error(memory, least, eye) if uncertain else (0.0, 0.0)
        for j in range(2):
            encoder = 0.0
            if abs(now[eye, j] - then[eye, j]) > 0.25 * rig.joint_step[eye, j]:
                encoder = _ENCODER * rig.joint_step[eye, j]
            model = _MODEL * (goals[j] - then[eye, j])
            variance = pixel + encoder * encoder + model * model + datings[j] * datings[j]
            before = memory.variance[eye, j] + _PROCESS * pixel
            innovation = goals[j] - memory.goals[eye, j]
            if begins:
                memory.goals[eye, j], memory.variance[eye, j] = goals[j], variance
                continue
            if innovation * innovation > _GATE * (before + variance):
                before += innovation * innovation
            gain = before / (before + variance)
            memory.goals[eye, j] += gain * innovation
            memory.variance[eye, j] = (1.0 - gain) * before


@device
def take_image(memory: Memory, rig: Rig, error: FloatArray, p: PackedHead, learn: bool) -> None:
    """Take a new image into the goals, and remember it.

    Args:
        memory: changed in place.
        rig: what is known of the joints.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        p: a packed head.
        learn: whether to find the delay on line.
    """
    _measure(memory, rig, error, p)
    if learn:
        _learn_delay(memory, rig)
    _filter(memory, rig, learn)
    memory.images[2] = memory.images[1]
    memory.images[1] = memory.images[0]


@device
def present_error(
    memory: Memory, p: PackedHead, eye: int, first: float, second: float
) -> tuple[float, float]:
    """The pixel error that one eye has at its present angles.

    Args:
        memory: what is remembered.
        p: a packed head.
        eye: which one.
        first: the present angle of its first joint, rad.
        second: that of its second, rad.

    Returns:
        Undistorted, along u and v, px; nan where it is not known.
    """
    if not isfinite(memory.goals[eye, 0]):
        return nan, nan
    # the point that is on the axis when the eye has turned there
    camera = eye_frames(p, eye, memory.goals[eye, 0], memory.goals[eye, 1]).camera
    px, py, pz = out_of(camera, 0.0, 0.0, memory.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first, second, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z

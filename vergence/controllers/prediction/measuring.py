"""Measurements of one image: its exposure time, each eye's goals and their variances."""

from math import isfinite, nan, sqrt
from typing import Final

from vergence.controllers.prediction.dating import SPACING_S
from vergence.controllers.prediction.joints import PredictorParameters
from vergence.controllers.prediction.predictor_state import PredictorState, angle_at
from vergence.kernels import inlined
from vergence.models.fixation import fixation_newton_step
from vergence.models.kinematics import PackedHead, eye_frames, point_to_local
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors

_RELATIVE_MODEL_SD: Final = 0.004
"""Model error of the head, standard deviation as a fraction of the angle to turn (chosen)."""
_ENCODER_SD_STEPS: Final = 0.3
"""Quantisation error of a moving joint's filtered angle, standard deviation as a fraction of the
resolution (chosen: that of one rounded angle)."""
LATENCY_JITTER_SD_S: Final = 0.006
"""Jitter of the frames' latency, standard deviation, s (chosen)."""
_MOVING_RAD_S: Final = 0.05
"""Joint speed above which encoder quantisation is added to the variance, rad/s (chosen)."""
_MAX_NEWTON_STEPS: Final = 10
"""Iteration limit of Newton's method (numerical)."""


@inlined
def average_over_delays(
    state: PredictorState,
    params: PredictorParameters,
    arrival_tick: float,
    first_active: int,
    end_active: int,
    weights: FloatArray,
    angles_by_delay: FloatArray,
    angles_at_exposure: FloatArray,
    delay_variance: FloatArray,
) -> float:
    """Average the exposure time of an image, and the joint angles then, over the delay hypotheses.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        arrival_tick: arrival of the image (its stamp if the camera stamps exposures), in periods.
        first_active: index of the first delay hypothesis that is not ruled out.
        end_active: index one past the last of them.
        weights: (HYPOTHESES,) weights of the delays.
        angles_by_delay: (HYPOTHESES, 2, 2) result: joint angles at the exposure under each delay,
            rad.
        angles_at_exposure: (2, 2) result: their weighted means, rad.
        delay_variance: (2, 2) result: their weighted variances, rad^2.

    Returns:
        The mean delay, s.
    """
    delay = 0.0
    for i in range(first_active, end_active):
        own = state.first_delay_s + SPACING_S * i
        delay += weights[i] * own
        for eye in range(2):
            for joint in range(2):
                tick = arrival_tick - own / params.period_s
                angles_by_delay[i, eye, joint] = angle_at(
                    state, params.sample_periods, tick, eye, joint
                )
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            for i in range(first_active, end_active):
                off = angles_by_delay[i, eye, joint] - angles_by_delay[first_active, eye, joint]
                mean += weights[i] * off
                square += weights[i] * off * off
            angles_at_exposure[eye, joint] = angles_by_delay[first_active, eye, joint] + mean
            delay_variance[eye, joint] = max(square - mean * mean, 0.0)
    return delay


@inlined
def measure_goals(
    state: PredictorState,
    p: PackedHead,
    angles_at_exposure: FloatArray,
    error: FloatArray,
    max_miss_ratio: float,
    goals: FloatArray,
) -> float:
    """Compute the goals of an image from the joint angles at its exposure.

    An eye that does not see the target gets the goals of the point that the other eye sees, at the
    depth last triangulated by both.

    Args:
        state: the predictor's state; its depths are changed in place.
        p: a packed head.
        angles_at_exposure: (2, 2) joint angles at the exposure, rad.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan where not visible.
        max_miss_ratio: largest miss distance of two rays to one target, divided by the target's
            distance.
        goals: (2, 2) result: joint angles that fixate the target, rad; nan for none.

    Returns:
        Miss distance of both eyes' rays, divided by the target's distance; nan unless both eyes see
        it.
    """
    left, right = rays_from_pixel_errors(
        p,
        eye_frames(p, 0, angles_at_exposure[0, 0], angles_at_exposure[0, 1]).camera,
        eye_frames(p, 1, angles_at_exposure[1, 0], angles_at_exposure[1, 1]).camera,
        error,
    )
    depths = depths_on_rays(left, right)
    # one eye alone, or two eyes on different targets, keep the depth last triangulated
    gap = nan
    if depths.valid:
        (ax, ay, az), (bx, by, bz) = left
        (cx, cy, cz), (dx, dy, dz) = right
        x = ax + depths.left * bx - cx - depths.right * dx
        y = ay + depths.left * by - cy - depths.right * dy
        z = az + depths.left * bz - cz - depths.right * dz
        gap = sqrt(x * x + y * y + z * z) / depths.left
        if gap < max_miss_ratio or state.known[0] + state.known[1] == 0.0:
            state.depth[0], state.depth[1] = depths.left, depths.right
    for eye in range(2):
        source = eye
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            source = 1 - eye
            if state.known[eye] < 0.5 or not isfinite(error[source, 0] + error[source, 1]):
                goals[eye, 0] = goals[eye, 1] = nan
                continue
        z = state.depth[source]
        o, d = left if source == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = angles_at_exposure[eye, 0], angles_at_exposure[eye, 1]
        if state.known[eye] > 0.5:  # Newton's method from the last goal needs one step
            q1, q2 = state.goals[eye, 0], state.goals[eye, 1]
        for _ in range(_MAX_NEWTON_STEPS):
            d1, d2 = fixation_newton_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # the error left is the square of this step
                break
        goals[eye, 0], goals[eye, 1] = q1, q2
        if source != eye:
            continue
        frames = eye_frames(p, eye, q1, q2)
        state.fixated_depth[eye] = point_to_local(frames.camera, x, y, z)[2]
    return gap


@inlined
def goal_variance(
    state: PredictorState,
    params: PredictorParameters,
    exposure_tick: float,
    eye: int,
    joint: int,
    angle_to_goal: float,
) -> float:
    """Variance of a measured goal for a known delay, rad^2.

    Args:
        state: the predictor's state.
        params: the head's parameters.
        exposure_tick: exposure time of the image, in periods.
        eye: index of the eye.
        joint: index of its joint.
        angle_to_goal: angle from the joint's position at the exposure to the goal, rad.
    """
    after = angle_at(state, params.sample_periods, exposure_tick + 0.5, eye, joint)
    before = angle_at(state, params.sample_periods, exposure_tick - 0.5, eye, joint)
    speed, model = (after - before) / params.period_s, _RELATIVE_MODEL_SD * angle_to_goal
    encoder = (
        _ENCODER_SD_STEPS * params.joint_step[eye, joint] if abs(speed) > _MOVING_RAD_S else 0.0
    )
    jitter = LATENCY_JITTER_SD_S * speed
    return state.detection_variance + jitter * jitter + model * model + encoder * encoder

"""Measurements of one image: its exposure time, goals and their variances, evidence on the delay.

The goals of a moving target change by themselves, so only abrupt motion of the eye carries evidence
on the delay. If the eye has accelerated more than targets do, the second difference of the goals of
three successive images is small under the true delay only.

An encoder on the motor's side does not show which end of the backlash (play) the eye is at: when a
motor has crossed it, the angles that fixate a resting target have shifted. An eye that turns to
each new goal lags by the images' delay every time and never comes to rest. Therefore goals get a
larger variance when a motor reverses. Goals that jump to and fro as their motors reverse reveal the
backlash; a mean of both lies within it, and there the eye keeps its direction.
"""

from math import inf, isfinite, nan, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.controllers.prediction.delay import HYPOTHESES, MAX_IMAGE_COST, SPACING_S
from vergence.controllers.prediction.motion_models import (
    MODELS,
    MODES,
    SWITCH_PROBABILITY,
    Motions,
    mean_rate,
    mix_models,
    passes_any_gate,
    predict_motions,
)
from vergence.controllers.prediction.parameters import PredictorParameters
from vergence.controllers.prediction.state import PredictorState, angle_at
from vergence.kernels import inlined, subroutine
from vergence.models.fixation import fixation_newton_step
from vergence.models.kinematics import PackedHead, eye_frames, joint_per_actuator, point_to_local
from vergence.models.parts import FloatArray
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors

_RELATIVE_MODEL_SD: Final = 0.004
"""Model error of the head, standard deviation as a fraction of the angle to turn (chosen)."""
_ENCODER_SD_STEPS: Final = 0.3
"""Quantisation error of a moving joint, standard deviation per resolution (chosen: one angle)."""
_LATENCY_JITTER_SD_S: Final = 0.006  # jitter of the frames' latency, standard deviation, s (chosen)
_MOVING_RAD_S: Final = 0.05
"""Joint speed above which encoder quantisation is added to the variance, rad/s (chosen)."""
_MAX_NEWTON_STEPS: Final = 10  # iteration limit of Newton's method (numerical)


class NewImage(NamedTuple):
    """A new image and what it measures by eye (2,), or eye and joint (2, 2); variances in rad^2."""

    arrival_tick: float  # its arrival (its stamp if the camera stamps exposures), in periods
    low: int  # index of the first delay hypothesis that is not ruled out
    high: int  # index one past the last of them
    angles_by_delay: FloatArray  # (HYPOTHESES, 2, 2) joint angles at the exposure by delay, rad
    angles: FloatArray  # (2, 2) their weighted means, from which the goals are computed, rad
    goals: FloatArray  # (2, 2) joint angles that fixate the target, rad; nan for none
    variance: FloatArray  # (2, 2) variances of the goals for a known delay
    delay_variance: FloatArray  # (2, 2) that the uncertain delay adds for a resting target
    moving_variance: FloatArray  # (2, 2) of the goals of a moving target
    backlash_variance: FloatArray  # (2, 2) that backlash adds for a resting target
    inferred: NDArray[np.bool_]  # (2,) an eye has the goals of the point that the other one sees
    tracked: NDArray[np.bool_]  # (2,) an eye sees its target, which was known before
    displaced: NDArray[np.bool_]  # (2,) the goal is displaced from that of rest
    matches_motion: NDArray[np.bool_]  # (2,) the goal passes the gate of a motion model


@inlined
def new_image(arrival_tick: float, low: int, high: int) -> NewImage:
    """Make an image before anything is measured in it."""
    return NewImage(
        arrival_tick, low, high, np.zeros((HYPOTHESES, 2, 2)), np.zeros((2, 2)), np.zeros((2, 2)),
        np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)),
        np.zeros(2, dtype=np.bool_), np.zeros(2, dtype=np.bool_),
        np.zeros(2, dtype=np.bool_), np.zeros(2, dtype=np.bool_),
    )  # fmt: skip


@inlined
def average_over_delays(
    values: FloatArray, weights: FloatArray, low: int, high: int,
    mean_out: FloatArray, variance_out: FloatArray,
) -> None:  # fmt: skip
    """Weighted mean and variance (2, 2) of values (HYPOTHESES, 2, 2) under the delays."""
    for eye in range(2):
        for joint in range(2):
            mean, square, first = 0.0, 0.0, values[low, eye, joint]
            for i in range(low, high):
                off = values[i, eye, joint] - first
                mean += weights[i] * off
                square += weights[i] * off * off
            mean_out[eye, joint] = first + mean
            variance_out[eye, joint] = max(square - mean * mean, 0.0)


@inlined
def find_exposure(
    state: PredictorState, params: PredictorParameters, image: NewImage, weights: FloatArray
) -> float:
    """Find the joint angles at an image's exposure under all delays; return the mean delay, s."""
    delay = 0.0
    for i in range(image.low, image.high):
        own = state.delays.first_s + SPACING_S * i
        delay += weights[i] * own
        tick = image.arrival_tick - own / params.period_s
        for eye in range(2):
            for joint in range(2):
                image.angles_by_delay[i, eye, joint] = angle_at(state, params, tick, eye, joint)
    average_over_delays(
        image.angles_by_delay, weights, image.low, image.high, image.angles, image.delay_variance
    )
    return delay


@inlined
def measure_goals(
    state: PredictorState, p: PackedHead, image: NewImage, error: FloatArray, max_miss_ratio: float
) -> float:
    """Compute the goals of an image from its undistorted pixel errors (2, 2), nan where not seen.

    An eye that does not see the target gets the goals of the point that the other eye sees, at the
    depth last triangulated by both. Return the miss distance of both eyes' rays, divided by the
    target's distance; nan unless both eyes see it.
    """
    target = state.target
    left, right = rays_from_pixel_errors(
        p,
        eye_frames(p, 0, image.angles[0, 0], image.angles[0, 1]).camera,
        eye_frames(p, 1, image.angles[1, 0], image.angles[1, 1]).camera,
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
        if gap < max_miss_ratio or target.known[0] + target.known[1] == 0.0:
            target.depth[0], target.depth[1] = depths.left, depths.right
    for eye in range(2):
        source = eye
        if not isfinite(error[eye, 0] + error[eye, 1]):
            image.inferred[eye], source = True, 1 - eye
            if target.known[eye] < 0.5 or not isfinite(error[source, 0] + error[source, 1]):
                image.goals[eye, :] = nan
                continue
        z = target.depth[source]
        o, d = left if source == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = image.angles[eye, 0], image.angles[eye, 1]
        if target.known[eye] > 0.5:  # Newton's method from the last goal needs one step
            q1, q2 = target.goals[eye, 0], target.goals[eye, 1]
        for _ in range(_MAX_NEWTON_STEPS):
            d1, d2 = fixation_newton_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # the error left is the square of this step
                break
        image.goals[eye, 0], image.goals[eye, 1] = q1, q2
        if source == eye:
            frames = eye_frames(p, eye, q1, q2)
            target.fixated_depth[eye] = point_to_local(frames.camera, x, y, z)[2]
    return gap


@inlined
def _joint_speed(
    state: PredictorState, params: PredictorParameters, tick: float, eye: int, joint: int
) -> float:
    """Mean velocity of a joint over the period about a time in periods, rad/s."""
    after = angle_at(state, params, tick + 0.5, eye, joint)
    return (after - angle_at(state, params, tick - 0.5, eye, joint)) / params.period_s


@inlined
def goal_variances(
    state: PredictorState, params: PredictorParameters, exposure_tick: float, image: NewImage
) -> None:
    """Compute the variances of measured goals for a known delay."""
    for eye in range(2):
        for joint in range(2 if isfinite(image.goals[eye, 0]) else 0):
            speed = _joint_speed(state, params, exposure_tick, eye, joint)
            model = _RELATIVE_MODEL_SD * (image.goals[eye, joint] - image.angles[eye, joint])
            step = params.joint_step[eye, joint] if abs(speed) > _MOVING_RAD_S else 0.0
            encoder, jitter = _ENCODER_SD_STEPS * step, _LATENCY_JITTER_SD_S * speed
            image.variance[eye, joint] = (
                state.target.detection_variance + jitter * jitter + model * model
                + encoder * encoder
            )  # fmt: skip


_TARGET_ACCELERATION_SD: Final = 4.0
"""Angular acceleration of a target, rad/s^2 (chosen: rare evidence against errors of the delay)."""
MODEL_ERROR_SD_RAD: Final = 0.0004
"""Standard deviation of a wholly known innovation, rad (chosen: model errors without a term)."""
INFORMATIVE_RATIO: Final = 16.0
"""Squared motion between extreme delays per variance that tells of the delay (chosen: 4 sigma)."""


@subroutine
def add_moving_target_costs(
    state: PredictorState, params: PredictorParameters, image: NewImage, added: FloatArray
) -> None:
    """Add the costs of the delays by the second differences of a moving target's goals."""
    one, two = state.motion.images[0], state.motion.images[1]
    first, second = image.arrival_tick - one.arrival_tick, one.arrival_tick - two.arrival_tick
    if not (0.0 < second < 40.0 and 0.0 < first < 40.0):
        return
    ratio = first / second
    more = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    swing, turns = _TARGET_ACCELERATION_SD * (first * params.period_s) ** 2, np.zeros(HYPOTHESES)
    for eye in range(2):
        if not isfinite(image.goals[eye, 0] + one.goals[eye, 0] + two.goals[eye, 0]):
            continue
        for joint in range(2):
            expected = more * image.variance[eye, joint] + swing * swing + MODEL_ERROR_SD_RAD**2
            rest = image.goals[eye, joint] - image.angles[eye, joint]
            rest -= (1.0 + ratio) * (one.goals[eye, joint] - one.angles_at_exposure[eye, joint])
            rest += ratio * (two.goals[eye, joint] - two.angles_at_exposure[eye, joint])
            least, most = inf, -inf
            for i in range(image.low, image.high):
                own = (state.delays.first_s + SPACING_S * i) / params.period_s
                turn = image.angles_by_delay[i, eye, joint]
                before = angle_at(state, params, one.arrival_tick - own, eye, joint)
                turn -= (1.0 + ratio) * before
                turn += ratio * angle_at(state, params, two.arrival_tick - own, eye, joint)
                turns[i], least, most = turn, min(least, turn), max(most, turn)
            # an eye that follows as smoothly as its target moves carries no evidence on the delay
            if (most - least) ** 2 > INFORMATIVE_RATIO * expected:
                for i in range(image.low, image.high):
                    added[i] += min((rest + turns[i]) ** 2 / expected, MAX_IMAGE_COST)


_DISPLACED_GATE: Final = 36.0
"""Squared Mahalanobis distance above which a goal is displaced (chosen: 6 sigma)."""
_UNMOVED_GATE: Final = 9.0
"""Squared Mahalanobis distance up to which a goal is where it was (chosen: 3 sigma)."""
_DISPLACED_S: Final = (0.1, 0.25)
"""Times of a displaced target alone and beside an unmoved one, s (chosen: errors against delay)."""


@inlined
def classify_innovations(
    state: PredictorState, image: NewImage, targets_move: bool, moves: bool, eyes_agree: bool
) -> int:
    """Test goals for displacement from rest and for motion; return how many eyes fit neither."""
    target, stays, outliers = state.target, False, 0
    for eye in range(2):
        if not image.tracked[eye]:
            continue
        square = 0.0
        for joint in range(2):  # squared Mahalanobis distance of the worse joint
            off = image.goals[eye, joint] - target.goals[eye, joint]
            known = target.filter_variance[eye, joint] + target.variance_over_delays[eye, joint]
            known += image.variance[eye, joint] + image.delay_variance[eye, joint]
            square = max(square, off * off / known)
        image.displaced[eye] = square > _DISPLACED_GATE
        stays = stays or square < _UNMOVED_GATE
    for eye in range(2):
        if not image.tracked[eye]:
            continue
        if targets_move:
            matches = passes_any_gate(
                state.motion.models[eye], state.motion.probabilities, image.goals[eye],
                image.moving_variance[eye],
            )  # fmt: skip
            # a resting target displaced in one eye only may be an outlier
            image.matches_motion[eye] = matches and (
                not image.displaced[eye] or moves or (eyes_agree and not stays)
            )
        if image.displaced[eye] and not image.matches_motion[eye]:
            outliers += 1
    return outliers


@inlined
def has_jumped(
    state: PredictorState, params: PredictorParameters, eye: int, image: NewImage,
    other_eye_unmoved: bool,
) -> bool:  # fmt: skip
    """True if the displaced detection of one eye has stayed long enough to be its target.

    A lamp or a reflection may be taken for the target in several images. So a displaced target has
    to be confirmed in as many images as the old one was, or for a time of `_DISPLACED_S`.
    """
    target = state.target
    again = target.displaced_image_count[eye] > 0.5
    for joint in range(2):
        off = image.goals[eye, joint] - target.displaced_goals[eye, joint]
        known = image.variance[eye, joint] + image.delay_variance[eye, joint]
        known = 2.0 * known + 2.0 * MODEL_ERROR_SD_RAD**2
        again = again and off * off <= _DISPLACED_GATE * known
        target.displaced_goals[eye, joint] = image.goals[eye, joint]
    count = target.displaced_image_count[eye] + 1.0 if again else 1.0
    target.displaced_image_count[eye] = count
    enough_s = _DISPLACED_S[1] if other_eye_unmoved else _DISPLACED_S[0]
    most = max(round(enough_s / params.frame_period_s), 2)
    return bool(count > min(max(target.confirmations[eye], 2.0), most) - 0.5)


_MIN_SPEED_RAD_S: Final = 0.02
"""Least joint speed by which the slip of the eye on the target is normalised, rad/s (chosen)."""
_MOVING_ENCODER_SD_STEPS: Final = 0.6
"""Error of a moving target's angle per resolution (chosen: images in a row share a rounding)."""


_CROSSING_SD_RAD: Final = 0.0006
"""Shift of a goal while a motor crosses its backlash, standard deviation, rad (chosen)."""
_BACKLASH_RAD: Final = (0.0012, 0.012)
"""Smallest and largest shift that is taken for backlash, rad (chosen)."""
_MIN_SQUARED_SHIFT: Final = 16.0
"""Squared shift of a goal per detection variance above which it is no noise (chosen: 4 sigma)."""
_MIN_REVERSING_COMMAND: Final = 0.01  # command below which a motor does not reverse, rad/s (chosen)
_RECENT_REVERSAL_S: Final = 0.25
"""Time after a reversal for which an eye may be at either end of the backlash, s (chosen)."""
_VARIANCE_DECAY: Final = 0.98
"""Per-image decay of the backlash variance that has been found (chosen)."""


@inlined
def inflate_variance_at_reversal(state: PredictorState, p: PackedHead, command: FloatArray) -> None:
    """Increase the variance of goals whose motors reverse by commands (4,) and cross backlash."""
    for k in range(4):
        side = 1.0 if command[k] > 0.0 else -1.0
        if abs(command[k]) < _MIN_REVERSING_COMMAND or state.backlash.last_direction[k] == side:
            continue
        state.backlash.last_direction[k] = side
        for j in range(4):
            share = joint_per_actuator(p, j, k)
            if share == 0.0:
                continue
            eye, joint, backlash = j // 2, j % 2, _CROSSING_SD_RAD * share
            state.target.filter_variance[eye, joint] += backlash * backlash
            state.backlash.reversal_tick[eye, joint] = state.periods
            motions: Motions = state.motion.models[eye]
            for m in range(MODELS):  # half, as the covariance is common to both joints
                motions[m].covariance[0] += 0.5 * backlash * backlash


@inlined
def _update_backlash_variance(
    state: PredictorState, params: PredictorParameters, exposure_tick: float, eye: int, joint: int,
    goal: float, at_rest: bool,
) -> float:  # fmt: skip
    """Update the backlash estimate with a goal; return its variance, 0 unless recently reversed."""
    backlash, at = state.backlash, (eye, joint)
    backlash.variance[at] *= _VARIANCE_DECAY
    if (exposure_tick - backlash.reversal_tick[at]) * params.period_s > _RECENT_REVERSAL_S:
        return 0.0
    off, least = goal - state.target.goals[at], _BACKLASH_RAD[0] * _BACKLASH_RAD[0]
    clear = off * off > max(_MIN_SQUARED_SHIFT * state.target.detection_variance, least)
    if at_rest and clear and abs(off) < _BACKLASH_RAD[1]:
        half = 0.5 * off
        if backlash.jump_sign[at] * off < 0.0:
            backlash.variance[at] = max(backlash.variance[at], half * half)
        backlash.jump_sign[at] = 1.0 if off > 0.0 else -1.0
    found: float = backlash.variance[at]
    return found


@inlined
def predict_motion(
    state: PredictorState, params: PredictorParameters, exposure_tick: float, image: NewImage,
    at_rest: bool,
) -> None:  # fmt: skip
    """Predict the motion models to an image, and compute the variances of goals of moving targets.

    An error of the exposure time moves a measured angle with the eye, but the target has moved too;
    only the velocity of the eye relative to the target (slip) remains.
    """
    motion = state.motion
    time_s = max(exposure_tick - motion.tick, 0.0) * params.period_s
    for eye in range(2):
        if state.target.known[eye] > 0.5:
            mix_models(motion.models[eye], motion.probabilities)
            predict_motions(motion.models[eye], time_s)
    other = SWITCH_PROBABILITY / MODELS  # Markov transition matrix
    for m in range(MODES):
        stays = (1.0 - SWITCH_PROBABILITY - other) * motion.probabilities[m]
        motion.probabilities[m] = stays + other
    motion.tick = exposure_tick
    for eye in range(2):
        for joint in range(2):
            speed = _joint_speed(state, params, exposure_tick, eye, joint)
            share = speed - mean_rate(motion.models[eye], motion.probabilities, joint)
            share = min((share / max(abs(speed), _MIN_SPEED_RAD_S)) ** 2, 1.0)
            dating = _LATENCY_JITTER_SD_S * _LATENCY_JITTER_SD_S * speed * speed
            own = image.variance[eye, joint] - (1.0 - share) * dating
            step = _MOVING_ENCODER_SD_STEPS * params.joint_step[eye, joint]
            late = share * image.delay_variance[eye, joint]
            image.moving_variance[eye, joint] = own + step * step + late
            if image.tracked[eye]:
                image.backlash_variance[eye, joint] = _update_backlash_variance(
                    state, params, exposure_tick, eye, joint, image.goals[eye, joint], at_rest
                )

r"""Each eye joint's goal: measured in images, told from outliers, filtered from image to image.

An image's goals are the angles that put its target, triangulated from the pixels and the angles
of its exposure, on the optical axes. Each joint's goal is filtered by a scalar Kalman filter for
each of the delays in question, see `vergence.controllers.prediction.dating`. A measurement's
variance is that of the detections, as their scatter about the goals shows it; of the encoders and of
the frames' jitter while the joint moves; of the head's model (a share of the angle to turn); and
what the likely delays make of it. So a resting eye averages noise, and an image that was exposed in
motion counts for little until its delay is known.

A goal far outside its variance is an outlier of the detector, or the target has jumped. Two eyes
that see it at one place in space, far from where it was, do not err: it has jumped. One eye alone
has to see it there twice.
"""

from math import exp, inf, isfinite, log, nan, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vergence._jit import device, subroutine
from vergence.controllers.prediction.dating import (
    HYPOTHESES,
    SPACING_S,
    add_misfit,
    take_misfits,
    unlikely,
    weigh,
)
from vergence.controllers.prediction.joints import RING, Rig
from vergence.controllers.prediction.memory import Memory, angle_at
from vergence.controllers.prediction.moving import (
    MODELS,
    WEIGHTS,
    add_surprises,
    ahead_of,
    begin_motion,
    begin_weights,
    carry_on,
    fits,
    infer,
    mix,
    rate_of,
    slow_share,
    switch,
    take_in,
    weigh_motions,
)
from vergence.models.fixation import fixate_step
from vergence.models.kinematics import eye_frames, point_in_eye
from vergence.models.packed import PackedHead, camera_of, joint_per_actuator
from vergence.models.parts import FloatArray
from vergence.models.pose import into, out_of
from vergence.triangulation.lines_of_sight import depths_on_rays, rays_of_image

_MODEL: Final = 0.004
"""Share of the angle to turn that the head's model leaves uncertain."""
_ENCODER: Final = 0.3
"""What tracking leaves of an encoder's step while the joint moves."""
_JITTER_S: Final = 0.006
"""By how much a frame comes later or earlier than others, standard deviation."""
_MOVING_RAD_S: Final = 0.05
_SLOW_RAD_S: Final = 0.02
_PROCESS: Final = 0.02
"""How much a goal may wander from image to image, as a share of the detections' variance."""
_PLAY_RAD: Final = 0.0006
"""By how much a goal moves as a motor crosses its play, standard deviation."""
_GATE: Final = 36.0
"""Square of the innovation, by its variance, beyond which a goal is elsewhere."""
_EXACT_RAD: Final = 0.0004
"""What remains of an innovation whatever is known."""
_SWING_RAD_S2: Final = 4.0
"""How much a target accelerates, when delays are weighed by one that moves."""
_TELLS: Final = 16.0
"""Square of the eye's motion in question, by the variance of a measured goal, that tells delays."""
_UNEVEN_RAD: Final = 0.0004
"""What play and friction make of a goal at rest, which is no motion."""
_UNEVEN: Final = 0.5
"""The same of an encoder, as a share of its step."""
_SURE: Final = 0.9
"""Probability of rest above which a target is taken to rest."""
_GRACE_S: Final = 0.03
"""So long after the next image should have come an eye goes on as its target did."""
_NOISE_SHARE: Final = 0.08
_LEAST_NOISE_PX: Final = 0.02
_MOST_NOISE_PX: Final = 3.0
_NEWTON: Final = 10


@device
def _measure(
    memory: Memory,
    p: PackedHead,
    then: FloatArray,
    error: FloatArray,
    most: float,
    goals: FloatArray,
) -> float:
    """The goals (2, 2) of an image from the joint angles (2, 2) at its exposure.

    An eye that does not see the target gets the goals of where the other one sees it, at the depth
    that both saw last.

    Returns:
        How far the rays of both eyes pass each other, by the target's distance; nan where not both
        eyes see it.
    """
    left, right = rays_of_image(
        p,
        eye_frames(p, 0, then[0, 0], then[0, 1]).camera,
        eye_frames(p, 1, then[1, 0], then[1, 1]).camera,
        error,
    )
    depths = depths_on_rays(left, right)
    # one eye alone, and two that do not see one target, keep the depth that both saw last
    gap = nan
    if depths.found:
        (ax, ay, az), (bx, by, bz) = left
        (cx, cy, cz), (dx, dy, dz) = right
        x = ax + depths.left * bx - cx - depths.right * dx
        y = ay + depths.left * by - cy - depths.right * dy
        z = az + depths.left * bz - cz - depths.right * dz
        gap = sqrt(x * x + y * y + z * z) / depths.left
        if gap < most or memory.known[0] + memory.known[1] == 0.0:
            memory.depth[0], memory.depth[1] = depths.left, depths.right
    for eye in range(2):
        sees = eye
        if not (isfinite(error[eye, 0]) and isfinite(error[eye, 1])):
            sees = 1 - eye
            if memory.known[eye] < 0.5 or not isfinite(error[sees, 0] + error[sees, 1]):
                goals[eye, 0] = goals[eye, 1] = nan
                continue
        z = memory.depth[sees]
        o, d = left if sees == 0 else right
        x, y, z = o[0] + z * d[0], o[1] + z * d[1], o[2] + z * d[2]
        q1, q2 = then[eye, 0], then[eye, 1]
        if memory.known[eye] > 0.5:  # Newton's method from the last goal needs one step
            q1, q2 = memory.goals[eye, 0], memory.goals[eye, 1]
        for _ in range(_NEWTON):
            d1, d2 = fixate_step(p, eye, q1, q2, x, y, z)
            q1 += min(max(d1, -0.5), 0.5)
            q2 += min(max(d2, -0.5), 0.5)
            if abs(d1) + abs(d2) < 1e-4:  # what is left is its square
                break
        goals[eye, 0], goals[eye, 1] = q1, q2
        if sees != eye:
            continue
        frames = eye_frames(p, eye, q1, q2)
        memory.fixated_depth[eye] = into(frames.camera, x, y, z)[2]
    return gap


@device
def _mix(memory: Memory, weights: FloatArray) -> None:
    """The goals' mean and variance over the delays."""
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            first = memory.goals_by_delay[0, eye, joint]
            for i in range(HYPOTHESES):
                off = memory.goals_by_delay[i, eye, joint] - first
                mean += weights[i] * off
                square += weights[i] * off * off
            memory.goals[eye, joint] = first + mean
            memory.doubt[eye, joint] = max(square - mean * mean, 0.0)


@device
def _date(
    memory: Memory,
    rig: Rig,
    came: float,
    weights: FloatArray,
    angles: FloatArray,
    then: FloatArray,
    spread: FloatArray,
) -> float:
    """The joints' angles at the exposure of an image that came at a time, in periods.

    Args:
        memory: what is remembered.
        rig: what is known of the head.
        came: when it came.
        weights: (HYPOTHESES,) those of the delays.
        angles: (HYPOTHESES, 2, 2) result: the angles by each delay, rad.
        then: (2, 2) result: their means.
        spread: (2, 2) result: their variances, rad^2.

    Returns:
        The mean delay, s.
    """
    delay = 0.0
    for i in range(HYPOTHESES):
        own = memory.first_delay_s + SPACING_S * i
        delay += weights[i] * own
        for eye in range(2):
            for joint in range(2):
                tick = came - own / rig.period_s
                angles[i, eye, joint] = angle_at(memory, rig.keep_every, tick, eye, joint)
    for eye in range(2):
        for joint in range(2):
            mean = square = 0.0
            for i in range(HYPOTHESES):
                off = angles[i, eye, joint] - angles[0, eye, joint]
                mean += weights[i] * off
                square += weights[i] * off * off
            then[eye, joint] = angles[0, eye, joint] + mean
            spread[eye, joint] = max(square - mean * mean, 0.0)
    return delay


@device
def take_image(memory: Memory, rig: Rig, error: FloatArray, p: PackedHead, learn: bool) -> None:
    """Take a new image into the goals.

    Args:
        memory: changed in place; `image_age_s` is that of the image.
        rig: what is known of the head.
        error: (2, 2) undistorted pixel errors by eye and image axis, px; nan unseen.
        p: a packed head.
        learn: whether to find the delay on line.
    """
    weights, then, spread = np.zeros(HYPOTHESES), np.zeros((2, 2)), np.zeros((2, 2))
    angles, goals = np.zeros((HYPOTHESES, 2, 2)), np.zeros((2, 2))
    inferred = np.zeros(2, dtype=np.bool_)
    came = memory.count - (memory.image_age_s - rig.dated_s) / rig.period_s
    # eyes that have rested since the longest delay stood where they stand
    still = memory.still > (RING - 4.0) * rig.keep_every
    exposed = came - memory.delay_s / rig.period_s
    if still:
        for eye in range(2):
            for joint in range(2):
                then[eye, joint] = angle_at(memory, rig.keep_every, exposed, eye, joint)
    else:
        weigh(memory.misfit, weights)
        memory.delay_s = _date(memory, rig, came, weights, angles, then, spread)
        exposed = came - memory.delay_s / rig.period_s
    depth = (memory.depth[0], memory.depth[1])
    most = rig.gap_rad + 4.0 * sqrt(2.0 * memory.noise)
    agree = _measure(memory, p, then, error, most, goals) < most
    if still:
        for i in range(HYPOTHESES):
            for eye in range(2):
                for joint in range(2):
                    angles[i, eye, joint] = then[eye, joint]
    for eye in range(2):
        inferred[eye] = not isfinite(error[eye, 0] + error[eye, 1])
    learn = learn and not still
    _filter(memory, rig, came, exposed, then, spread, angles, goals, inferred, depth, agree, learn)
    if still:
        weigh(memory.misfit, weights)
    _mix(memory, weights)


@device
def _variance(memory: Memory, rig: Rig, exposed: float, eye: int, joint: int, turn: float) -> float:
    """The variance of a measured goal but for its date, rad^2, the joint having to turn so far."""
    after = angle_at(memory, rig.keep_every, exposed + 0.5, eye, joint)
    before = angle_at(memory, rig.keep_every, exposed - 0.5, eye, joint)
    speed, model = (after - before) / rig.period_s, _MODEL * turn
    encoder = _ENCODER * rig.joint_step[eye, joint] if abs(speed) > _MOVING_RAD_S else 0.0
    jitter = _JITTER_S * speed
    return memory.noise + jitter * jitter + model * model + encoder * encoder


@device
def _is_elsewhere(
    memory: Memory, eye: int, goals: FloatArray, variance: FloatArray, spread: FloatArray
) -> bool:
    """Whether an image shows an eye's target far from where it was."""
    for joint in range(2):
        off = goals[eye, joint] - memory.goals[eye, joint]
        known = memory.variance[eye, joint] + memory.doubt[eye, joint]
        if off * off > _GATE * (known + variance[eye, joint] + spread[eye, joint]):
            return True
    return False


@device
def _is_again_there(
    memory: Memory, eye: int, goals: FloatArray, variance: FloatArray, spread: FloatArray
) -> bool:
    """Whether it shows it where the last image did, that was not where it had been."""
    if memory.apart[eye] < 0.5:
        return False
    for joint in range(2):
        off = goals[eye, joint] - memory.elsewhere[eye, joint]
        known = 2.0 * (variance[eye, joint] + spread[eye, joint]) + 2.0 * _EXACT_RAD**2
        if off * off > _GATE * known:
            return False
    return True


@device
def _carry_motions(memory: Memory, rig: Rig, exposed: float) -> None:
    """Bring the targets' motions to the time of an image, in periods."""
    time_s = max(exposed - memory.moved_at, 0.0) * rig.period_s
    mixed = np.zeros((MODELS, 12))
    for eye in range(2):
        if memory.known[eye] > 0.5:
            mix(memory.motions[eye], memory.ways, mixed)
            carry_on(memory.motions[eye], time_s)
    switch(memory.ways)
    memory.moved_at = exposed


@device
def _slips(
    memory: Memory,
    rig: Rig,
    exposed: float,
    variance: FloatArray,
    spread: FloatArray,
    slip: FloatArray,
) -> None:
    """Variances (2, 2) of measured angles of moving targets: an error of the date leaves the slip."""
    for eye in range(2):
        for joint in range(2):
            after = angle_at(memory, rig.keep_every, exposed + 0.5, eye, joint)
            before = angle_at(memory, rig.keep_every, exposed - 0.5, eye, joint)
            speed = (after - before) / rig.period_s
            share = (speed - rate_of(memory.motions[eye], memory.ways, joint)) / max(abs(speed), _SLOW_RAD_S)
            share = min(share * share, 1.0)
            dating = _JITTER_S * _JITTER_S * speed * speed
            own = variance[eye, joint] - (1.0 - share) * dating
            slip[eye, joint] = own + share * spread[eye, joint]


@device
def _begin(
    memory: Memory,
    eye: int,
    goals: FloatArray,
    then: FloatArray,
    angles: FloatArray,
    variance: FloatArray,
    agree: bool,
) -> None:
    """Let an eye's goals begin anew with an image."""
    memory.known[eye], memory.sure[eye] = 1.0, 1.0 if agree else 0.0
    for joint in range(2):
        memory.variance[eye, joint] = variance[eye, joint]
        for i in range(HYPOTHESES):
            off = angles[i, eye, joint] - then[eye, joint]
            memory.goals_by_delay[i, eye, joint] = goals[eye, joint] + off


@device
def _keep(memory: Memory, came: float, goals: FloatArray, then: FloatArray) -> None:
    """Remember an image."""
    memory.images[1] = memory.images[0]
    image = memory.images[0]
    image.came = came
    for eye in range(2):
        for joint in range(2):
            image.goals[eye, joint], image.then[eye, joint] = goals[eye, joint], then[eye, joint]


@subroutine
def _compare(
    memory: Memory,
    rig: Rig,
    came: float,
    then: FloatArray,
    angles: FloatArray,
    goals: FloatArray,
    variance: FloatArray,
    added: FloatArray,
) -> None:
    """Weigh the delays by a target that moves: by the second differences of its goals."""
    one, two = memory.images[0], memory.images[1]
    first, second = came - one.came, one.came - two.came
    if not (0.0 < second < 40.0 and 0.0 < first < 40.0):
        return
    ratio = first / second
    more = 1.0 + (1.0 + ratio) ** 2 + ratio * ratio
    swing, turns = _SWING_RAD_S2 * (first * rig.period_s) ** 2, np.zeros(HYPOTHESES)
    for eye in range(2):
        if not isfinite(goals[eye, 0] + one.goals[eye, 0] + two.goals[eye, 0]):
            continue
        for joint in range(2):
            spread = more * variance[eye, joint] + swing * swing + _EXACT_RAD**2
            rest = goals[eye, joint] - then[eye, joint]
            rest -= (1.0 + ratio) * (one.goals[eye, joint] - one.then[eye, joint])
            rest += ratio * (two.goals[eye, joint] - two.then[eye, joint])
            low, high = inf, -inf
            for i in range(HYPOTHESES):
                own = (memory.first_delay_s + SPACING_S * i) / rig.period_s
                turn = angles[i, eye, joint]
                before = angle_at(memory, rig.keep_every, one.came - own, eye, joint)
                turn -= (1.0 + ratio) * before
                turn += ratio * angle_at(memory, rig.keep_every, two.came - own, eye, joint)
                turns[i], low, high = turn, min(low, turn), max(high, turn)
            # eyes that follow as smoothly as their target moves do not tell it from themselves
            if (high - low) ** 2 > _TELLS * spread:
                for i in range(HYPOTHESES):
                    add_misfit(added, (rest + turns[i]) ** 2 / spread, i)


@device
def _filter(
    memory: Memory,
    rig: Rig,
    came: float,
    exposed: float,
    then: FloatArray,
    spread: FloatArray,
    angles: FloatArray,
    goals: FloatArray,
    inferred: NDArray[np.bool_],
    depth: tuple[float, float],
    agree: bool,
    learn: bool,
) -> None:
    """Take a new image's goals into the filtered ones, and into the delays' misfits."""
    variance, added = np.zeros((2, 2)), np.zeros(HYPOTHESES)
    seen = apart = 0.0
    for eye in range(2):
        if not isfinite(goals[eye, 0]):
            continue
        seen += 1.0
        for joint in range(2):
            turn = goals[eye, joint] - then[eye, joint]
            variance[eye, joint] = _variance(memory, rig, exposed, eye, joint, turn)
    follows = rig.follows > 0.5
    moves = follows and memory.ways[0] < 0.5
    slip, motion_off = np.zeros((2, 2)), np.zeros(2)
    if follows:
        _carry_motions(memory, rig, exposed)
        _slips(memory, rig, exposed, variance, spread, slip)
    elsewhere, on_its_way = np.zeros(2, dtype=np.bool_), np.zeros(2, dtype=np.bool_)
    for eye in range(2):
        if inferred[eye] or not isfinite(goals[eye, 0]) or memory.known[eye] < 0.5:
            continue
        elsewhere[eye] = _is_elsewhere(memory, eye, goals, variance, spread)
        if follows:
            fit = fits(memory.motions[eye], memory.ways, goals[eye], slip[eye])
            # a target that has rested may also be an outlier
            on_its_way[eye] = fit and (not elsewhere[eye] or moves or agree)
        if elsewhere[eye] and not on_its_way[eye]:
            apart += 1.0
    if apart == 1.0:  # of two eyes one errs, and so does the depth
        memory.depth[0], memory.depth[1] = depth[0], depth[1]
    scatter = count = 0.0
    explained = np.zeros(HYPOTHESES)
    surprises, own_surprises, exact = np.zeros(WEIGHTS), np.zeros(WEIGHTS), np.zeros(2)
    likely = 1
    for m in range(2, WEIGHTS):
        likely = m if memory.ways[m] > memory.ways[likely] else likely
    if follows and memory.known[0] + memory.known[1] == 0.0:
        begin_weights(memory.ways)
    # an eye whose goals the other one tells comes after it
    first = 1 if inferred[0] else 0
    for number in range(2):
        eye = number ^ first
        if not isfinite(goals[eye, 0]):
            continue
        motions = memory.motions[eye]
        if inferred[eye]:
            if moves and memory.apart[1 - eye] < 0.5:
                infer(motions, goals[eye], slip[eye])
            goals[eye, 0] = goals[eye, 1] = nan
            continue
        if elsewhere[eye] and not on_its_way[eye]:
            jumped = (apart == 2.0 and agree) or memory.sure[eye] < 0.5
            if not (jumped or _is_again_there(memory, eye, goals, variance, spread)):
                memory.apart[eye] = 1.0
                for joint in range(2):
                    memory.elsewhere[eye, joint] = goals[eye, joint]
                continue
        memory.apart[eye] = 0.0
        if on_its_way[eye]:
            own_surprises[:] = 0.0
            explained[:] = 0.0
            for joint in range(2):
                step = _UNEVEN * rig.joint_step[eye, joint]
                exact[joint] = _UNEVEN_RAD * _UNEVEN_RAD + step * step
                known = memory.variance[eye, joint] + variance[eye, joint] + exact[joint]
                own_surprises[0] += 0.5 * log(known)
                for i in range(HYPOTHESES):
                    off = goals[eye, joint] - then[eye, joint] + angles[i, eye, joint]
                    off -= memory.goals_by_delay[i, eye, joint]
                    add_misfit(explained, off * off / known, i)
                off = goals[eye, joint] - motions[likely - 1].angle[joint]
                known = motions[likely - 1].covariance[0] + slip[eye, joint]
                # what the detection has of it (expectation and maximization)
                share = memory.noise / known
                motion_off[joint] = (share * off) ** 2 + (1.0 - share) * memory.noise
            take_in(motions, goals[eye], slip[eye], exact, own_surprises)
            own_surprises[0] += unlikely(memory.misfit, explained)
            add_surprises(surprises, own_surprises)
        elif follows:
            begin_motion(motions, goals[eye], variance[eye, 0])
        if elsewhere[eye] or memory.known[eye] < 0.5:
            _begin(memory, eye, goals, then, angles, variance, agree or on_its_way[eye])
            continue
        memory.sure[eye] = 1.0
        for joint in range(2):
            before = memory.variance[eye, joint] + _PROCESS * memory.noise
            own = variance[eye, joint]
            gain = before / (before + own + spread[eye, joint])
            low, high = inf, -inf
            for i in range(HYPOTHESES):
                low, high = min(low, angles[i, eye, joint]), max(high, angles[i, eye, joint])
            expected = before + own + _EXACT_RAD**2
            tells = not moves and (high - low) ** 2 > _TELLS * expected
            for i in range(HYPOTHESES):
                off = angles[i, eye, joint] - then[eye, joint]
                innovation = goals[eye, joint] + off - memory.goals_by_delay[i, eye, joint]
                if tells:
                    add_misfit(added, innovation * innovation / expected, i)
                memory.goals_by_delay[i, eye, joint] += gain * innovation
            off = goals[eye, joint] - memory.goals[eye, joint]
            calm = spread[eye, joint] < 0.1 * memory.noise and own < 1.1 * memory.noise
            if calm and not moves:
                scatter += off * off / (1.0 + before / memory.noise)
                count += 1.0
            elif moves and on_its_way[eye]:
                scatter += motion_off[joint]
                count += 1.0
            memory.variance[eye, joint] = (1.0 - gain) * before
    if follows:
        weigh_motions(memory.ways, surprises)
    if learn and moves:
        _compare(memory, rig, came, then, angles, goals, variance, added)
    if learn:
        take_misfits(memory.misfit, added)
    _keep(memory, came, goals, then)
    if count > 0.0:
        least, most = _LEAST_NOISE_PX * rig.pixel_rad, _MOST_NOISE_PX * rig.pixel_rad
        found = min(scatter / count, 9.0 * memory.noise)
        share = 0.25 * count * _NOISE_SHARE
        noise = memory.noise + share * (found - memory.noise)
        memory.noise = min(max(noise, least * least), most * most)


@device
def cross_play(memory: Memory, p: PackedHead, command: FloatArray) -> None:
    """Let the goals be less sure where a motor is about to turn round, and cross its play.

    Args:
        memory: changed in place.
        p: a packed head.
        command: (4,) the actuators' commands, rad/s.
    """
    for k in range(4):
        if command[k] == 0.0:
            continue
        side = 1.0 if command[k] > 0.0 else -1.0
        if memory.direction[k] != side:
            memory.direction[k] = side
            for j in range(4):
                play = _PLAY_RAD * joint_per_actuator(p, j, k)
                memory.variance[j // 2, j % 2] += play * play


@device
def aim_ahead(memory: Memory, rig: Rig, tick: float) -> None:
    """Where the targets will be at a time in periods, and how fast they move then."""
    moves = rig.follows > 0.5 and memory.ways[0] < _SURE
    shows_s = exp(memory.response.found[2]) + 0.5 * rig.period_s
    expected_s = memory.delay_s + rig.frame_s + (tick - memory.count) * rig.period_s + _GRACE_S
    slow = 1.0
    for eye in range(2):
        for joint in range(2):
            memory.aims[eye, joint], memory.rates[eye, joint] = memory.goals[eye, joint], 0.0
            memory.later_rates[eye, joint] = 0.0
            if moves and memory.known[eye] > 0.5:
                time_s = (tick - memory.moved_at) * rig.period_s
                motions, resting = memory.motions[eye], memory.goals[eye, joint]
                if joint == 0:
                    slow = slow_share(motions, memory.ways, rig.sees)
                angle, rate = ahead_of(
                    motions, memory.ways, resting, joint, time_s, expected_s, slow
                )
                memory.aims[eye, joint], memory.rates[eye, joint] = angle, rate
                time_s += shows_s
                _, rate = ahead_of(
                    motions, memory.ways, resting, joint, time_s, expected_s + shows_s, slow
                )
                memory.later_rates[eye, joint] = rate


@device
def present_error(
    memory: Memory, p: PackedHead, eye: int, first: float, second: float
) -> tuple[float, float]:
    """The pixel error that one eye has at some angles.

    Args:
        memory: what is remembered.
        p: a packed head.
        eye: which one.
        first: the angle of its first joint, rad.
        second: that of its second, rad.

    Returns:
        Undistorted, along u and v, px; nan where it is not known.
    """
    if memory.known[eye] < 0.5:
        return nan, nan
    # the point that is on the axis when the eye has turned there
    camera = eye_frames(p, eye, memory.aims[eye, 0], memory.aims[eye, 1]).camera
    px, py, pz = out_of(camera, 0.0, 0.0, memory.fixated_depth[eye])
    x, y, z = point_in_eye(p, eye, first, second, px, py, pz)
    if not z > 0.0:
        return nan, nan
    lens = camera_of(p, eye)
    return lens.focal_u * x / z, lens.focal_v * y / z

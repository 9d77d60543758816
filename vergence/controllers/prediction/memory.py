"""What the predictor remembers of a head, and how its part on the joints is kept up to date.

Arrays (2, 2) are by eye and joint, first and second; arrays of four by actuator of the eyes. Times
are those in which the joints are read.
"""

from typing import Annotated, Final

import numpy as np

from vergence._jit import device
from vergence.controllers.prediction.dating import HYPOTHESES, first_delay, first_misfits
from vergence.controllers.prediction.fitting import learn_response
from vergence.controllers.prediction.joints import RIG, RING, Rig
from vergence.controllers.prediction.moving import MODELS, WEIGHTS, EyeMotion
from vergence.controllers.prediction.observer import Observer, begin_comparison, is_prompt, observe
from vergence.controllers.prediction.response import (
    COMMANDS,
    SPEEDS,
    Response,
    advance,
    answer_of,
    first_answers,
    sent,
)
from vergence.controllers.prediction.swinging import (
    FIRST_PATIENCE_S,
    Swinging,
    begin_watch,
)
from vergence.controllers.rows import make_row, row_layout, row_size
from vergence.envs.layout import AGE_S
from vergence.models.packed import PackedHead, actuator_at, actuator_rate, is_direct, joint_at
from vergence.models.parts import FloatArray
from vergence.triangulation.lines_of_sight import DEFAULT_DEPTH_M

_STILL_RAD_S: Final = 0.005
"""Slower, no delay in question moves the eye by a pixel."""
NOISE_PX: Final = 0.25
"""Noise of a detection before any is known, at least."""


class Image:
    """An image that came before."""

    came: float
    """When, in periods; negative for none."""
    goals: Annotated[FloatArray, 2, 2]
    """The angles that fixate its target, rad; nan for an eye that did not see it."""
    then: Annotated[FloatArray, 2, 2]
    """The joints' angles by which these were found, rad."""


class Memory:
    """What is remembered of one head."""

    count: float
    """Periods since the first observation of the trial, -1 before it."""
    image_age_s: float
    """Age of the newest image, for the next period to tell whether there is a newer one."""
    response: Response
    observer: Observer
    swinging: Swinging
    actuators: Annotated[FloatArray, 4]
    """Angles of the actuators as they are read now, finer than the encoders, rad."""
    velocity: Annotated[FloatArray, 4]
    """Velocities of the actuators, rad/s."""
    still: float
    """Periods since a joint has turned."""
    direction: Annotated[FloatArray, 4]
    """Where each was told to go last: 1, -1, or 0 for nowhere yet."""
    turned: Annotated[FloatArray, 2, 2]
    """When a motor of each joint was told to turn round last, in periods."""
    flip: Annotated[FloatArray, 2, 2]
    """To which side a goal jumped last as its motor turned round: 1, -1, or 0."""
    play: Annotated[FloatArray, 2, 2]
    """What the play that was found makes of a measured goal, rad^2."""
    angles: Annotated[FloatArray, RING, 2, 2]
    """The joints' angles by period, or every second or third, see `Rig.keep_every`: a ring in which
    the k-th has the place k modulo `RING`."""
    first_delay_s: float
    """The first of the delays in question."""
    misfit: Annotated[FloatArray, HYPOTHESES]
    """How badly each delay has explained the images, see `dating`."""
    low: float
    """The first of the delays in question."""
    high: float
    """The one after the last."""
    delay_s: float
    """The likely delay from an exposure to its reading, less that of the joints."""
    goals_by_delay: Annotated[FloatArray, HYPOTHESES, 2, 2]
    """Angles that fixate the target at rest by each delay, rad."""
    goals: Annotated[FloatArray, 2, 2]
    """Their mean."""
    doubt: Annotated[FloatArray, 2, 2]
    """Their variance, rad^2."""
    variance: Annotated[FloatArray, 2, 2]
    """The variance that each of them has of its own, rad^2."""
    noise: float
    """Variance of a detection by the focal length, rad^2."""
    known: Annotated[FloatArray, 2]
    """Whether each eye's target is known: 1 or 0."""
    sure: Annotated[FloatArray, 2]
    """How many images have confirmed it."""
    apart: Annotated[FloatArray, 2]
    """How many images in a row, up to the last, showed it at one place elsewhere."""
    elsewhere: Annotated[FloatArray, 2, 2]
    """The angles that fixate that, rad."""
    motions: Annotated[list[EyeMotion], 2, MODELS]
    """What is known of the targets if they move, by eye and model."""
    turns: float
    """How many times the target has been taken to rest or to move, in turns, lately."""
    images: Annotated[list[Image], 2]
    """The last image, and the one before."""
    moved_at: float
    """When that is, in periods."""
    ways: Annotated[FloatArray, WEIGHTS]
    """The probabilities that they rest, and that they move as the models have it."""
    aims: Annotated[FloatArray, 2, 2]
    """The angles that fixate the targets when the next command acts, rad."""
    rates: Annotated[FloatArray, 2, 2]
    """How fast they change then, rad/s."""
    later_rates: Annotated[FloatArray, 2, 2]
    """How fast they change when that command shows: a lag and half a period later, rad/s."""
    unseen: Annotated[FloatArray, 2]
    """Periods since an image showed each eye its target."""
    depth: Annotated[FloatArray, 2]
    """Depth at which each eye saw its target last, m."""
    fixated_depth: Annotated[FloatArray, 2]
    """Depth of each eye's target once it is on the axis, m."""


MEMORY: Final = row_layout(Memory)
SIZE: Final = row_size(MEMORY)
"""Length of the row."""


def initial_row(
    rig_row: FloatArray, stamped: bool, learn_delay: bool, learn_response: bool
) -> FloatArray:
    """(SIZE,) what is remembered before the first observation.

    Args:
        rig_row: see `vergence.controllers.prediction.joints.joint_rig`.
        stamped: whether images are dated by the camera.
        learn_delay: whether the delay is found on line.
        learn_response: whether the actuators' response is.
    """
    rig: Rig = rig_row.view(RIG)[0]
    response = np.zeros(1, dtype=MEMORY["response"])
    response["begun"] = -1.0
    for name, value in first_answers(rig.response_s, rig.lag_s, learn_response).items():
        response["answers"][name] = value
    swinging = np.zeros(1, dtype=MEMORY["swinging"])
    swinging["patience_s"] = FIRST_PATIENCE_S
    images = np.zeros(2, dtype=MEMORY["images"].base)
    images["came"] = -1e9
    return make_row(
        MEMORY,
        count=-1.0,
        turned=-1e9,
        image_age_s=AGE_S,
        response=response,
        swinging=swinging,
        first_delay_s=first_delay(rig.latency_s),
        misfit=first_misfits(rig.latency_s, stamped, learn_delay),
        high=HYPOTHESES,
        delay_s=rig.latency_s,
        noise=(max(rig.detection_px, NOISE_PX) * rig.pixel_rad) ** 2,
        depth=DEFAULT_DEPTH_M,
        images=images,
    )


@device
def angle_at(memory: Memory, every: float, tick: float, eye: int, joint: int) -> float:
    """A joint's angle at a time in periods, by the cubic through the four that are kept about it.

    Args:
        memory: what is remembered.
        every: see `Rig.keep_every`.
        tick: the time.
        eye: which eye.
        joint: which of its joints.
    """
    last = np.floor(memory.count / every)
    tick = min(max(tick / every, last - (RING - 4.0)), last)
    i = min(int(np.floor(tick)), int(last) - 2)
    s = tick - i
    a = memory.angles[np.uintp((i - 1) & (RING - 1)), eye, joint]
    b = memory.angles[np.uintp(i & (RING - 1)), eye, joint]
    c = memory.angles[np.uintp((i + 1) & (RING - 1)), eye, joint]
    d = memory.angles[np.uintp((i + 2) & (RING - 1)), eye, joint]
    near = (s + 1.0) * (s - 2.0)
    angle: float = (s * (s - 1.0) / 6.0) * ((s + 1.0) * d - (s - 2.0) * a)
    angle += 0.5 * near * ((s - 1.0) * b - s * c)
    return angle


@device
def track(
    memory: Memory,
    rig: Rig,
    p: PackedHead,
    positions: FloatArray,
    velocities: FloatArray,
    command: FloatArray,
    learn: bool,
) -> None:
    """Bring the angles, the velocities and the response up to date with a period's readings.

    Args:
        memory: changed in place.
        rig: what is known of the head.
        p: a packed head.
        positions: (7,) joint angles as read, rad.
        velocities: (7,) joint velocities as read, rad/s.
        command: (4,) the actuators' velocities that were commanded, rad/s.
        learn: whether to learn the response.
    """
    memory.count += 1.0
    memory.still += 1.0
    tick, direct, begins = int(memory.count), is_direct(p), memory.count == 0.0
    response = memory.response
    answer = answer_of(response)
    prompt = is_prompt(memory.observer)
    response.prompt = 1.0 if prompt else 0.0
    before, now = np.uintp((tick - 1) & (COMMANDS - 1)), np.uintp(tick & (SPEEDS - 1))
    for j in range(4):
        angle, rate = positions[3 + j], velocities[3 + j]
        if not direct:
            angle = actuator_at(p, j, positions[3:])
            rate = actuator_rate(p, j, velocities[3:])
        if begins:  # at rest
            memory.actuators[j], memory.velocity[j] = angle, rate
            response.angles[j] = angle
            begin_comparison(memory.observer, j, angle, rate)
            continue
        response.commands[before, j] = sent(rig, command[j])
        q, v = memory.actuators[j], memory.velocity[j]
        w = response.accelerations[j]
        ahead_q, ahead_v, w = advance(response, answer, rig, tick - 1, j, q, v, w)
        response.accelerations[j] = w
        q, v = observe(
            memory.observer, response, rig, tick - 1, j, v, ahead_q, ahead_v, angle, rate
        )
        memory.actuators[j], memory.velocity[j] = q, v
        response.means[now, j] = (angle - response.angles[j]) / rig.period_s
        response.angles[j] = angle
        response.speeds[now, j] = rate if prompt else v
        if abs(memory.velocity[j]) > _STILL_RAD_S:
            memory.still = 0.0
    every = int(rig.keep_every)
    slot = np.uintp(tick // every & (RING - 1))
    for j in range(4 if tick % every == 0 else 0):
        q = memory.actuators[j] if direct else joint_at(p, j, memory.actuators)
        if begins:
            begin_watch(memory.swinging, j // 2, j % 2, q)
            for place in range(RING):
                memory.angles[place, j // 2, j % 2] = q
        memory.angles[slot, j // 2, j % 2] = q
    if learn and not begins:
        learn_response(response, rig, tick)

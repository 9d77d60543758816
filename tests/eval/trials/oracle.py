"""A controller that cheats: it knows the goal, the true lag, gain and delays, and the true angles.

At each step it gives every actuator the command that carries it farthest while it can still stop on
its goal: bang-bang control as far as commands that hold for a period allow it. It begins with the
first image in which either eye finds the target, reckons with the commands that are on their way,
and takes its motors through their play to the flank that pushes.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tests.joint_motion import respond
from vergence.envs.plant import simulation_of
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel
from vergence.models.motion import follow_torque_limited_joint

Array = NDArray[np.float64]
HALVINGS = 30


def begin(task: GazeTask, seed: int) -> GazeTask:
    trials = np.arange(task.num, dtype=np.uint64)
    task.begin(np.arange(task.num), np.full(task.num, seed, np.uint64), trials)
    return task


class Joints(NamedTuple):
    """Limits of the eyes' actuators, (n, 4)."""

    lag: Array
    a: Array
    top: Array
    """Greatest speeds, gain included, rad/s."""
    torque_falloff: Array
    """Fraction by which 1 rad/s reduces the acceleration."""


@njit
def _with_torque_falloff(q, v, u, lag, a, torque_falloff, time):
    ends, speeds = np.empty_like(q), np.empty_like(q)
    for n in range(q.shape[0]):
        for k in range(q.shape[1]):
            ends[n, k], speeds[n, k] = follow_torque_limited_joint(
                q[n, k], v[n, k], u[n, k], lag[n, k], a[n, k], torque_falloff[n, k], time[n, k]
            )
    return ends, speeds


def advance(q: Array, v: Array, u: Array, joints: Joints, time: Array) -> tuple[Array, Array]:
    """Angles and velocities (n, 4) a time (n, 4) later."""
    if joints.torque_falloff.any():
        return _with_torque_falloff(q, v, u, joints.lag, joints.a, joints.torque_falloff, time)
    return respond(q, v, u, joints.lag, joints.a, time)


def stopping_place(q: Array, v: Array, lag: Array, a: Array, top: Array) -> Array:
    """Angles at which joints stop under full reverse."""
    speed = np.abs(v)
    least = np.maximum(a * lag - top, 0.0)  # below it, the lag no longer allows a
    time = np.maximum(speed - least, 0.0) / a
    time = time + lag * np.log((np.minimum(speed, least) + top) / top)
    return respond(q, v, -np.sign(v) * top, lag, a, time)[0]


def goals(task: GazeTask) -> Array:
    """(n, 4) the angles of the eyes' actuators with the least true error."""
    return eye_goals(task) if task.head.actuation.direct else tied_goals(task)


def tied_goals(task: GazeTask) -> Array:
    """(n, 4) angles of actuators that tie joints, by SciPy's least squares over each true head."""
    simulation, actuation = simulation_of(task.plant), task.head.actuation
    truth, population = simulation.truth_at_rest(), simulation.true_head
    goal = np.zeros((task.num, 7))
    for n, target in enumerate(truth.target):
        true = population[n] if population.batch_shape else population

        def error(own: Array, true: HeadModel = true, target: Array = target) -> Array:
            actuators = np.zeros(7)
            actuators[3 : 3 + actuation.count] = own
            pixels = true.project(actuation.joints_of(actuators), target)
            return np.ravel(task.head.undistort(pixels) - task.head.cameras.principal)

        begin = actuation.actuators_of(true.fixate(target))[3 : 3 + actuation.count]
        found = least_squares(error, begin, xtol=1e-15, ftol=1e-15, gtol=1e-12)
        goal[n, 3 : 3 + actuation.count] = found.x
    return goal[:, 3:]


def eye_goals(task: GazeTask) -> Array:
    """(n, 4) the eyes' angles of no true error, by Newton's method on the true heads."""
    truth, true = simulation_of(task.plant).truth_at_rest(), simulation_of(task.plant).true_head
    q = true.fixate(truth.target)
    principal = task.head.cameras.principal
    for _ in range(20):
        error = true.project(q, truth.target) - principal
        for eye in range(2):
            columns = []
            for joint in (3 + 2 * eye, 4 + 2 * eye):
                step = np.zeros(7)
                step[joint] = 1e-5
                ahead = true.project(q + step, truth.target)[:, eye]
                behind = true.project(q - step, truth.target)[:, eye]
                columns.append((ahead - behind) / 2e-5)
            jacobian = np.stack(columns, axis=-1)
            turn = np.linalg.solve(jacobian, error[:, eye, :, None])[..., 0]
            q[:, 3 + 2 * eye : 5 + 2 * eye] -= turn
    assert np.abs(true.project(q, truth.target) - principal).max() < 1e-6
    return q[:, 3:]


def run(task: GazeTask, steps: int, beyond_px: float) -> tuple[Array, Array]:
    """Run trials that have just begun: (steps + 1,) s and (steps + 1, n, 2, 2) true pixel errors.

    Each actuator stops so far beyond its goal: it enters the band earlier, and stops nearer to its
    edge.
    """
    simulation = simulation_of(task.plant)
    truth, conditions = simulation.truth(), simulation.conditions
    actuation, period = simulation.true_head.actuation, task.head.timing.period_s
    moves = actuation.velocity[3:] > 0.0
    gain = conditions.speed_gain[:, 3:]
    top = np.where(moves, gain * actuation.velocity[3:], 1.0)
    joints = Joints(
        lag=conditions.lag_s[:, None] * actuation.lag_ratio[3:],
        a=conditions.acceleration_ratio[:, None] * np.where(moves, actuation.acceleration[3:], 1.0),
        top=top,
        torque_falloff=conditions.torque_falloff[:, None] / top,
    )
    goal = goals(task)
    start = actuation.actuators_of(truth.positions)[:, 3:]
    side = np.sign(goal - start)
    goal += side * (beyond_px / task.head.cameras.focal.mean())
    play = conditions.backlash_rad[:, 3:]
    goal += 0.5 * side * play
    first = np.ceil(simulation.first_detection_times()[0] / period - 1e-6)
    late = conditions.command_latency_s
    whole = np.floor(late / period + 1e-9).astype(int)
    rest = np.broadcast_to(np.maximum(late - whole * period, 0.0)[:, None], goal.shape)
    full = np.full(goal.shape, period)
    places = np.arange(task.num)
    # the commands that were given last, the newest first, rad/s
    given = np.zeros((int(whole.max()) + 1, *goal.shape))
    speed = np.zeros_like(goal)
    errors = [truth.pixel_error]
    for step in range(steps):
        # how the joints stand when the command that is given now begins to count
        q, v = truth.motors[:, 3:], truth.velocities[:, 3:] @ actuation.to_actuators.T
        if play.any():  # a motor turns where its joint may stand still
            v = speed
        q, v = advance(q, v, given[whole, places], joints, rest)
        begun = v
        for back in range(len(given) - 1, 0, -1):
            later = advance(q, v, given[back - 1], joints, full)
            waits = (back <= whole)[:, None]
            q, v = np.where(waits, later[0], q), np.where(waits, later[1], v)
        low, high = -top, top
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            after = advance(q, v, middle, joints, full)
            short = stopping_place(*after, joints.lag, joints.a, top) <= goal
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        u = np.where(step >= first[:, None], 0.5 * (low + high), 0.0)
        task.step(task.layout.action(u / gain))
        sent = task.reading.command[:, 3:]
        sent = np.where(np.abs(sent) < 1.5 * task.head.sensor.command_resolution_rad_s, 0.0, sent)
        given = np.concatenate([(gain * sent)[None], given])
        speed = advance(q, begun, given[whole, places], joints, full - rest)[1]
        given = given[:-1]
        truth = simulation.truth()
        errors.append(truth.pixel_error)
    return np.arange(steps + 1) * period, np.array(errors)

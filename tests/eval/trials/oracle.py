"""A controller that cheats: it knows the goal, the true lag and the true angles.

At each step it gives every actuator the command that carries it farthest while it can still stop on
its goal: bang-bang control as far as commands that hold for a period allow it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tests.joint_motion import respond
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel

Array = NDArray[np.float64]
HALVINGS = 40


def stopping_place(q: Array, v: Array, lag: Array, a: Array, top: Array) -> Array:
    """Where joints stop under full reverse."""
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
    simulation, actuation = task.plant.simulation, task.head.actuation
    assert simulation is not None
    truth, population = simulation.truth(), simulation.true_head
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
    truth, conditions = task.truth(), task.plant.conditions
    assert truth is not None
    assert conditions is not None
    true: HeadModel = task.plant.true_head  # type: ignore[attr-defined]
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
    """Run trials that have just begun.

    Args:
        task: the trials.
        steps: how many control periods.
        beyond_px: how far beyond the goal each actuator stops: earlier in the band, nearer its
            edge.

    Returns:
        (steps + 1,) seconds and (steps + 1, n, 2, 2) true pixel errors.
    """
    truth, conditions = task.truth(), task.plant.conditions
    assert truth is not None
    assert conditions is not None
    actuation, period = task.head.actuation, task.head.timing.period_s
    moves = actuation.velocity[3:] > 0.0
    top = np.where(moves, actuation.velocity[3:], 1.0)
    a = np.where(moves, actuation.acceleration[3:], 1.0)
    goal = goals(task)
    start = actuation.actuators_of(truth.positions)[:, 3:]
    goal += np.sign(goal - start) * beyond_px / task.head.cameras.focal.mean()
    lag = conditions.lag_s[:, None] * actuation.lag_ratio[3:]
    errors = [truth.pixel_error]
    for step in range(steps):
        q = actuation.actuators_of(truth.positions)[:, 3:]
        v = truth.velocities[:, 3:] @ actuation.to_actuators.T
        low, high = np.broadcast_to(-top, q.shape), np.broadcast_to(top, q.shape)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            after = respond(q, v, middle, lag, a, np.full(q.shape, period))
            short = stopping_place(*after, lag, a, top) <= goal
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        command = np.where(step >= conditions.latency_frames[:, None], 0.5 * (low + high), 0.0)
        task.step(task.layout.action(command))
        truth = task.truth()
        assert truth is not None
        errors.append(truth.pixel_error)
    return np.arange(steps + 1) * period, np.array(errors)

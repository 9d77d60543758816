"""Laws on heads of any shape: they settle where the head's actuators can bring both images."""

import numpy as np
import pytest

from tests.controllers.loops import begin, drive, pixel_errors
from tests.heads import head_of
from tests.naming import named, refused
from vergence.controllers import CONTROLLERS, make_controller
from vergence.controllers.ibvs import reducible_pixel_error
from vergence.envs.task import GazeTask
from vergence.eval.trials.goal import least_reachable_error
from vergence.models import HeadModel, ModelErrors

LAWS = [name for name in CONTROLLERS if not name.startswith("learned")]
HEADS = ["tied", "mis", "panfirst", "common", "vergeonly"]
BAND_PX = 1.0


def distances(
    head: HeadModel, *runs: tuple[str, float], errors: ModelErrors | None = None, **options
):
    """(steps, num) how far the images are from the least error of the true heads, px.

    The laws run one after the other for some seconds; the last one has the options.
    """
    num = 12
    true = errors and head.perturbed(np.random.default_rng(4), errors, size=num)
    plant = {"true_head": true} if true else {}
    task = begin(GazeTask(num, plant="kinematic", head=head, plant_options=plant), seed=5)
    # a target at the edge of the model's view may be out of that of the true head
    in_view = (np.abs(task.truth().pixel_error) < [150.0, 110.0]).all(axis=(1, 2))
    seen = []
    for k, (law, time_s) in enumerate(runs):
        own = options if k == len(runs) - 1 else {}
        controller = make_controller(law, head, task.layout, **own)
        seen += [pixel_errors(task) for _ in drive(task, controller, time_s)]
    least = least_reachable_error(task, task.truth().target)
    task.close()
    assert in_view.sum() > 8
    return np.linalg.norm(np.array(seen) - least, axis=-1).max(axis=-1)[:, in_view]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "name"), [(law, HEADS[i % len(HEADS)]) for i, law in enumerate(LAWS)]
)
def test_every_law_settles_where_the_head_can(name, law):
    away = distances(head_of(name), (law, 1.5))
    assert away[0].max() > 10.0
    assert away[-24:].max() < BAND_PX


@pytest.mark.parametrize(
    ("law", "name"), [("ibvs", "mis"), ("state-feedback", "tied"), ("pursuit", "common")]
)
def test_a_head_that_differs_from_its_model_settles_at_its_own_least_error(name, law):
    errors = ModelErrors(
        link_m=1e-3, coaxiality_rad=0.01, joint_offset_rad=0.01, head_eye_rad=0.01, principal_px=2.0
    )
    assert distances(head_of(name), (law, 1.5), errors=errors)[-24:].max() < BAND_PX


def test_each_axis_of_each_eye_has_its_own_gain():
    """The least squares that the law says it solves, in NumPy: u = (J A)^+ -K (J A) (J A)^+ e."""
    gains, error = np.array([[3.0, 5.0], [6.0, 2.0]]), np.array([[4.0, -3.0], [-2.0, 5.0]])
    for name in HEADS:
        head = head_of(name)
        law = make_controller("ibvs", head, gain=gains, depth=0.8)
        pixels = head.cameras.principal + error
        jacobian = head.image_jacobian(np.zeros(7), pixels, np.full(2, 0.8))
        by_actuator = jacobian[..., 3:].reshape(4, 4) @ head.actuation.to_joints
        inverse = np.linalg.pinv(by_actuator)
        wanted = -gains.ravel() * (by_actuator @ inverse @ error.ravel())
        count = by_actuator.shape[1]
        with named(name):
            command = law.command(np.zeros(7), error)[:count]
            assert command == pytest.approx((inverse @ wanted)[:count], rel=1e-6, abs=1e-9)


def test_an_integral_does_not_wind_up_on_what_cannot_be_taken_away():
    away = distances(head_of("common"), ("saccade", 0.5), ("pid", 3.0), ki=3.0)
    assert away[60:].max() < 0.3


def test_the_reducible_part_is_what_the_actuators_can_undo():
    head = head_of("common")
    point = np.array([0.1, 0.05, 0.8])
    q = head.fixate(point)
    least = head.least_error(point)
    assert np.abs(least).max() > 10.0
    assert np.abs(reducible_pixel_error(head, q, least, np.nan)).max() < 1e-3
    # turned away by one actuator, the error has that turn in it and nothing else
    away = head.actuation.actuators_of(q)
    away[4] += 1e-4
    turned = head.actuation.joints_of(away)
    error = head.project(turned, point, distorted=False) - head.cameras.principal
    part = reducible_pixel_error(head, turned, error, np.nan)
    assert part == pytest.approx(error - least, abs=2e-3)


def test_a_head_with_four_motors_keeps_its_errors_as_they_are():
    head, error = head_of("panfirst"), np.array([[3.0, -40.0], [np.nan, np.nan]])
    assert reducible_pixel_error(head, np.zeros(7), error, np.nan) is error


@pytest.mark.parametrize("law", ["ibvs", "pursuit"])
def test_one_eye_alone_is_brought_to_its_target(law):
    head = head_of("tied")
    task = begin(GazeTask(4, plant="kinematic", head=head), seed=5)
    right = [task.layout.fields["visible"].start + 1]
    for part in ("pixel_error", "pixel_error_fine"):
        right += range(*task.layout.fields[part].indices(task.layout.size))[2:]

    def cover(observation, _step):
        observation[:, right] = 0.0

    assert len([*drive(task, make_controller(law, head, task.layout), 1.5, cover)]) == 180
    assert np.linalg.norm(task.truth().pixel_error[:, 0], axis=-1).max() < BAND_PX
    task.close()


def test_a_fixed_pair_has_nothing_to_control():
    for law in CONTROLLERS:
        refused("eyes move, got 'pair', a fixed pair", make_controller, law, head_of("pair"))

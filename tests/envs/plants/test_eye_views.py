"""Images drawn for a posture are those that a simulated head sees there."""

import numpy as np
import pytest

from tests.envs.trials import begin, start_of
from vergence.envs.plant import make_plant
from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.envs.streams import RandomStreams, StreamPurpose
from vergence.envs.targets.motion import motion_rows
from vergence.errors import ConfigurationError
from vergence.vision.targets import make_planar_target

SEED = 3
POINT, VELOCITY = np.array([0.05, -0.1, 0.9]), np.array([0.3, -0.1, 0.2])
COMMAND = [0.4, 0.0, -0.2, 1.0, -1.5, 0.8, 1.2]
PERIODS = 20
VIEW = {"board": "tag", "facing": "forward", "width_rad": "fit"}


def frame_noise(period: int) -> np.random.Generator:
    """The generator of the frame that is exposed at the end of a period of the first trial."""
    streams = RandomStreams(1)
    streams.start(np.arange(1), np.full(1, SEED, np.uint64), np.zeros(1, np.uint64))
    return streams.generator_at(0, StreamPurpose.IMAGE, 2 * period)


def views_of(head) -> BoardImageRenderer:
    own = {name: value for name, value in VIEW.items() if name != "board"}
    return BoardImageRenderer(head, make_planar_target("tag"), **own)


def worst_grey(ours, theirs) -> int:
    """The greatest difference of grey levels in both eyes."""
    return max(
        int(np.abs(a.astype(int) - b.astype(int)).max()) for a, b in zip(ours, theirs, strict=True)
    )


@pytest.fixture
def seen(physical):
    """A plant after some periods in which the head, its eyes and the board have moved."""
    plant = make_plant("rendered", physical, 1, **VIEW)
    start = start_of(point=POINT, seed=SEED)
    begin(plant, start._replace(motions=motion_rows(POINT, velocity=VELOCITY)))
    for _ in range(PERIODS):
        plant.step(np.array([COMMAND]))
    return plant


@pytest.mark.slow
def test_eyes_at_rest_see_what_the_rendered_plant_shows(physical):
    plant = make_plant("rendered", physical, 1, **VIEW)
    begin(plant, start_of(point=POINT, seed=SEED))
    for _ in range(2):
        plant.step(np.zeros((1, 7)))
    drawn = views_of(physical).draw(np.zeros(7), np.zeros(7), POINT, frame_noise(2))
    assert np.ptp(drawn[0]) > 100
    # a pose that differs in its last digit may round a grey level the other way
    assert worst_grey(drawn, plant.frames()) <= 1


@pytest.mark.slow
def test_eyes_in_motion_see_what_the_rendered_plant_shows(physical, seen):
    truth = seen.truth()
    q, v, point = truth.positions[0], truth.velocities[0], truth.target[0]
    turned = np.linalg.inv(physical.base_pose(q)) @ physical.base_pose(np.zeros(7))
    velocity = turned[:3, :3] @ VELOCITY
    views = views_of(physical)
    drawn = views.draw(q, v, point, frame_noise(PERIODS), velocity)
    assert worst_grey(drawn, seen.frames()) <= 1
    for still in ((np.zeros(7), velocity), (v, np.zeros(3))):
        drawn = views.draw(q, still[0], point, frame_noise(PERIODS), still[1])
        assert worst_grey(drawn, seen.frames()) > 5


def test_where_there_is_no_target_the_background_is_plain(physical):
    views = views_of(physical)
    views.draw(np.zeros(7), np.zeros(7), POINT)
    assert views.board_in_image == (True, True)
    for image in views.draw(np.zeros(7), np.ones(7), [np.nan] * 3):
        assert np.ptp(image) == 0
    assert views.board_in_image == (False, False)


def test_a_board_that_fits_looks_equally_large_near_and_far(physical):
    widths = []
    for away in (1.0, 3.0):
        left, _right = views_of(physical).draw(np.zeros(7), np.zeros(7), away * POINT)
        widths.append(np.ptp(np.flatnonzero((left != left[0, 0]).any(axis=0))))
    assert widths[0] == pytest.approx(widths[1], abs=3)
    assert widths[0] > 50


def test_the_true_eyes_see_a_board_that_fits_the_model(physical):
    true = physical.replace(cameras={"focal": 1.1 * physical.cameras.focal})
    target = make_planar_target("tag")
    of_model = BoardImageRenderer(physical, target, width_rad="fit").board
    fitted = BoardImageRenderer(true, target, width_rad="fit", model=physical).board
    assert fitted.true_size_distance_m == of_model.true_size_distance_m


def test_a_board_with_axes_of_its_own_is_drawn_by_them(physical):
    views = BoardImageRenderer(physical, make_planar_target("checkerboard"), facing="forward")
    level = [image.copy() for image in views.draw(np.zeros(7), np.zeros(7), POINT)]
    rolled = np.diag([-1.0, -1.0, 1.0])
    same = [image.copy() for image in views.draw(np.zeros(7), np.zeros(7), POINT, axes=np.eye(3))]
    turned = views.draw(np.zeros(7), np.zeros(7), POINT, axes=rolled)
    assert worst_grey(level, same) == 0
    assert worst_grey(level, turned) > 50


def test_an_unknown_facing_is_refused(physical):
    with pytest.raises(ConfigurationError, match="facing: expected 'head' or 'forward', got 'up'"):
        BoardImageRenderer(physical, make_planar_target("tag"), facing="up")

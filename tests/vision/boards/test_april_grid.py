"""AprilGrids as Kalibr prints them, whole or in part; corners that are hidden are nan."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import Scene, jpeg, ramp, rms, scene, shadow
from vergence.models.camera import Lens, camera_matrix
from vergence.models.parts import Rendering
from vergence.vision import AprilGrid, Camera, TagFamily, make_detector

GRID = AprilGrid(columns=5, rows=4, tag_m=0.05)
PINHOLE = Camera(size=(640, 480), matrix=camera_matrix((520.0, 520.0), (320.3, 240.1)))
FISHEYE = Camera(
    size=(640, 480), matrix=camera_matrix((260.0, 260.0), (320.3, 240.1)),
    lens=Lens("fisheye", (-0.01, 0.005, -0.002, 0.0005)),
)  # fmt: skip


RENDERING = Rendering(
    blur_px=0.7, noise_grey=2.0, supersampling=2,
    black_grey=40.0, white_grey=210.0, background_grey=120.0,
)  # fmt: skip


def drawn(
    board: AprilGrid = GRID,
    z: float = 0.5,
    turn: tuple[float, float, float] = (0.3, -0.2, 0.0),
    camera: Camera = PINHOLE,
    x: float = 0.0,
    blur_px: float = 0.7,
    seed: int = 1,
) -> Scene:
    rng = np.random.default_rng(seed)
    rendering = replace(RENDERING, blur_px=blur_px)
    return scene(camera, board, pose(x, 0.01, z, turn), rendering, rng)


@pytest.mark.slow
def test_every_corner_is_found_in_the_boards_order():
    for roll in (0.1, np.pi / 2, np.pi, -1.7):
        with named(roll):
            one = drawn(turn=(0.0, 0.0, roll))
            found = make_detector(GRID).detect(one.image)
            np.testing.assert_allclose(found.corners_px, one.corners, atol=0.15)
            np.testing.assert_allclose(found.point_px, one.point, atol=5.0 * found.sigma_px.max())


@pytest.mark.parametrize(("z", "blur_px"), [(0.5, 0.5), (0.5, 1.5), (1.2, 0.5)])
def test_sigmas_hold_the_errors(z, blur_px):
    """Also of tags of 22 px, whose bits have 2."""
    one = drawn(z=z, blur_px=blur_px)
    found = make_detector(GRID).detect(one.image)
    errors = found.corners_px - one.corners
    assert np.isfinite(errors).all()
    assert 0.8 < rms(errors / found.corners_sigma_px) < 1.25
    assert rms(errors) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_a_wide_lens_hides_no_corner_that_it_bends(known):
    """The board reaches 50 degrees off the axis."""
    one = drawn(z=0.18, turn=(0.1, 0.2, 0.3), camera=FISHEYE)
    found = make_detector(GRID, FISHEYE if known else None).detect(one.image)
    errors = found.corners_px - one.corners
    there = np.isfinite(errors).all(axis=1)
    inside = ((one.corners > 3.0) & (one.corners < (636.0, 476.0))).all(axis=1)
    assert there.sum() >= (0.99 if known else 0.9) * inside.sum()
    assert np.abs(errors[there]).max() < 0.2
    assert rms(errors[there] / found.corners_sigma_px[there]) < 1.3


def test_hidden_corners_are_nan_and_the_others_where_they_are():
    one = drawn()
    v, u = np.indices(one.image.shape)
    beyond = (u - one.point[0]) * 0.8 + (v - one.point[1]) * 0.6
    hidden = np.where(beyond > 20.0, 120, one.image).astype(np.uint8)
    found = make_detector(GRID).detect(hidden)
    there = np.isfinite(found.corners_px).all(axis=1)
    across = (one.corners - one.point) @ [0.8, 0.6]
    assert not there[across > 20.0].any()
    assert there.sum() > 0.6 * (across < 10.0).sum()
    # what covers the board ends in the windows of some
    np.testing.assert_allclose(found.corners_px[there], one.corners[there], atol=0.25)


def test_a_board_that_the_images_edge_cuts_is_found_in_part():
    one = drawn(x=-0.3)
    found = make_detector(GRID).detect(one.image)
    there = np.isfinite(found.corners_px).all(axis=1)
    assert 8 <= there.sum() < len(there)
    np.testing.assert_allclose(found.corners_px[there], one.corners[there], atol=0.15)


@pytest.mark.slow
def test_light_and_files_move_corners_by_little():
    one = drawn()
    for kind, change in {"shadow": shadow(0.5), "ramp": ramp(0.2), "JPEG": jpeg(30)}.items():
        with named(kind):
            found = make_detector(GRID).detect(change(one.image, one.point))
            errors = found.corners_px - one.corners
            there = np.isfinite(errors).all(axis=1)
            assert there.mean() > 0.8
            assert np.median(np.abs(errors[there])) < 0.1
            assert np.abs(errors[there]).max() < 1.5


def test_a_board_that_is_hidden_in_part_is_tracked_and_comes_back():
    detector, one = make_detector(GRID), drawn()
    hidden = one.image.copy()
    hidden[:, int(one.point[0]) :] = 120
    found = detector.track(hidden, detector.detect(one.image))
    assert 0.3 < np.isfinite(found.corners_px[:, 0]).mean() < 0.6
    assert np.isfinite(detector.track(one.image, found).corners_px).all()


def test_a_board_that_is_gone_is_lost_through_a_lens_too():
    detector = make_detector(GRID, FISHEYE)
    before = detector.detect(drawn(camera=FISHEYE, z=0.3).image)
    assert before is not None
    assert detector.track(np.full((480, 640), 120, np.uint8), before) is None


@pytest.mark.slow
def test_other_boards_are_none():
    image = drawn().image
    for change in ({"columns": 4, "rows": 5}, {"rows": 3}, {"spacing": 0.25}):
        with named(change):
            assert make_detector(replace(GRID, **change)).detect(image) is None
    assert make_detector(GRID).detect(np.ascontiguousarray(image[:, ::-1])) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn", "columns", "rows"), [((0.0, 0.0, 0.0), 3, 1), ((0.6, 0.3, 1.0), 10, 10)]
)
def test_a_row_that_other_counts_share_is_not_taken_for_their_board(turn, columns, rows):
    """The first row has the numbers of any wider board; a hand hides a part of it."""
    image = drawn(turn=turn, z=0.4).image.copy()
    image[:, :200] = 120
    other = AprilGrid(columns=columns, rows=rows, tag_m=0.05)
    assert make_detector(other).detect(image) is None
    for way in range(3):
        assert make_detector(other).search(image, way=way) is None
    assert make_detector(GRID).detect(image) is not None


def test_a_tag_of_another_board_on_the_grid_hides_no_board():
    one = drawn(turn=(0.0, 0.0, 0.0))
    image, tags = one.image.copy(), np.rint(one.corners.reshape(-1, 4, 2)).astype(int)
    (u, v), (u_end, v_end) = tags[7, 0], tags[7, 2]
    stray = cv2.resize(GRID.tag_bits(300), (u_end - u, v_end - v), interpolation=cv2.INTER_AREA)
    image[v:v_end, u:u_end] = np.clip(stray, 40, 210)
    found = make_detector(GRID).detect(image)
    assert np.isfinite(found.corners_px).all(axis=1).sum() >= len(one.corners) - 4


def test_a_board_is_tracked_and_a_copy_through_pickle_says_the_same():
    detector = make_detector(GRID)
    one, other = drawn(), drawn(z=0.505, turn=(0.3, -0.2, 0.01))
    before = pickle.loads(pickle.dumps(detector)).detect(one.image)
    np.testing.assert_array_equal(before.corners_px, detector.detect(one.image).corners_px)
    found = detector.track(other.image, before)
    np.testing.assert_allclose(found.corners_px, other.corners, atol=0.15)


@pytest.mark.slow
def test_no_tag_of_it_is_taken_for_a_single_one_with_a_border_of_one_bit():
    """The inside of its border reads like one, of 4/5 of the size."""
    near = drawn(z=0.15, turn=(0.1, -0.1, 0.05))
    assert make_detector(TagFamily(family="36h11")).detect_all(near.image) == []

"""ChArUco boards of both layouts, whole or in part; corners that are hidden are nan."""

import pickle

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import Scene, cropped, glare, jpeg, ramp, rig, rms, scene, shadow
from vergence.vision import CharucoBoard, make_detector

BOARDS = {
    "7x5": CharucoBoard(columns=7, rows=5),
    "6x4": CharucoBoard(columns=6, rows=4),
    "6x4 legacy": CharucoBoard(columns=6, rows=4, legacy=True),
    "5x6 legacy": CharucoBoard(columns=5, rows=6, legacy=True),
    "8x5 5X5": CharucoBoard(columns=8, rows=5, marker_m=0.026, dictionary="DICT_5X5_100"),
}


def drawn(board: CharucoBoard, roll: float = 0.0, z: float = 0.8, seed: int = 1) -> Scene:
    camera, rendering = rig("simulated")
    T_C_T = pose(0.013, -0.021, z) @ pose(0, 0, 0, (0, 0, roll)) @ pose(0, 0, 0, (0.2, -0.2, 0))
    return scene(camera, board, T_C_T, rendering, np.random.default_rng(seed))


def detector_of(board: CharucoBoard):
    return make_detector(board, rig("simulated")[0])


def test_every_corner_is_found_in_opencvs_order():
    for roll, name in some_of([0.0, 0.8, np.pi / 2, np.pi, -2.2], list(BOARDS)):
        with named(roll, name):
            board = BOARDS[name]
            one = drawn(board, roll)
            found = detector_of(board).detect(one.image)
            assert found.target == board
            assert np.isfinite(found.corners_px).all()
            assert found.corners_px == pytest.approx(one.corners, abs=0.25)
            assert rms(found.corners_px - one.corners) < 0.08
            assert found.point_px == pytest.approx(one.point, abs=0.05)


@pytest.mark.parametrize("name", ["6x4 legacy", "5x6 legacy"])
def test_a_board_of_the_old_layout_need_not_be_called_that(name):
    board = BOARDS[name]
    asked = CharucoBoard(columns=board.columns, rows=board.rows)
    one = drawn(board, 0.3)
    found = detector_of(asked).detect(one.image)
    assert found.target == board
    assert found.corners_px == pytest.approx(one.corners, abs=0.25)
    tracked = detector_of(asked).track(one.image, found)
    assert tracked.target == board


def test_a_board_of_the_new_layout_is_none_where_the_old_one_was_asked_for():
    one = drawn(BOARDS["6x4"], 0.3)
    assert detector_of(BOARDS["6x4 legacy"]).detect(one.image) is None


@pytest.mark.parametrize(
    ("side", "grey"), [((1, 0), 0), ((-1, 0), 255), ((0, 1), 255), ((0, -1), 120), ((0.7, 0.7), 0)]
)
def test_hidden_corners_are_nan_and_the_others_where_they_are(side, grey):
    """Half of the board is behind a hand; the middle is known by the other half."""
    board = BOARDS["7x5"]
    one = drawn(board, 0.3)
    v, u = np.indices(one.image.shape)
    beyond = (u - one.point[0]) * side[0] + (v - one.point[1]) * side[1]
    hidden = np.where(beyond > 8.0, grey, one.image).astype(np.uint8)
    found = detector_of(board).detect(hidden)
    there = np.isfinite(found.corners_px).all(axis=1)
    corners_beyond = (one.corners - one.point) @ side
    assert there.sum() >= 6
    assert not there[corners_beyond > 8.0].any()
    inside = there & (corners_beyond < 0.0)
    assert found.corners_px[inside] == pytest.approx(one.corners[inside], abs=0.25)
    np.testing.assert_array_equal(np.isfinite(found.corners_sigma_px).all(axis=1), there)
    assert np.isfinite(found.sigma_px).all()
    assert found.point_px == pytest.approx(one.point, abs=0.3)


def test_a_board_that_the_images_edge_cuts_is_found_in_part():
    camera, rendering = rig("simulated")
    board = BOARDS["7x5"]
    x = (0 - camera.principal[0]) / camera.focal[0] * 0.8
    one = scene(camera, board, pose(x, 0.0, 0.8), rendering, np.random.default_rng(2))
    found = make_detector(board, camera).detect(one.image)
    there = np.isfinite(found.corners_px).all(axis=1)
    assert 4 <= there.sum() < len(there)
    assert not there[one.corners[:, 0] < 0.0].any()
    assert found.corners_px[there] == pytest.approx(one.corners[there], abs=0.25)


LIGHTS = {
    "half shadow": shadow(0.5, 0.5), "ramp": ramp(0.2, 0.5, 250.0), "glare": glare(210.0, 40.0),
    "JPEG of quality 30": jpeg(30),
}  # fmt: skip


def test_light_and_files_move_the_corners_found_by_little():
    board = BOARDS["7x5"]
    one = drawn(board, 0.3)
    for kind, change in LIGHTS.items():
        with named(kind):
            found = detector_of(board).detect(change(one.image, one.point))
            errors = found.corners_px - one.corners
            there = np.isfinite(errors).all(axis=1)
            assert there.sum() >= 12
            assert np.median(np.abs(errors[there])) < 0.1
            assert rms(errors[there]) < 2.0 * rms(found.corners_sigma_px[there])


@pytest.mark.parametrize("z", [0.6, 1.2])
def test_sigmas_hold_the_errors(z):
    """To a factor of 1.7 over places anywhere in the pixel grid."""
    camera, rendering = rig("simulated")
    board, rng = BOARDS["7x5"], np.random.default_rng(3)
    detector = make_detector(board, camera)
    errors, said = [], []
    for _ in range(8):
        x, y = rng.uniform(-0.05, 0.05, 2)
        one = scene(camera, board, pose(x, y, z, (0.2, 0.1, 0.2)), rendering, rng)
        found = detector.detect(one.image)
        there = np.isfinite(found.corners_px).all(axis=1)
        assert there.sum() >= 18
        errors.extend((found.corners_px - one.corners)[there])
        said.extend(found.corners_sigma_px[there])
    assert rms(errors) / 1.7 < rms(said) < 1.7 * rms(errors)


def test_another_board_is_none():
    one = cropped(drawn(BOARDS["7x5"]))
    others = (
        CharucoBoard(columns=7, rows=5, dictionary="DICT_5X5_50"),
        CharucoBoard(columns=7, rows=5, dictionary="DICT_6X6_50"),
    )
    for other in others:
        assert make_detector(other).detect(one.image) is None
    mirrored = np.ascontiguousarray(one.image[:, ::-1])
    assert make_detector(BOARDS["7x5"]).detect(mirrored) is None


MORE = [(0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1), (2, 0), (-2, 0)]


@pytest.mark.parametrize("name", ["7x5", "6x4", "6x4 legacy", "5x6 legacy"])
def test_a_board_of_similar_counts_is_none(name):
    """A part of the markers is where the board asked for has them, others beside it."""
    board = BOARDS[name]
    one = cropped(drawn(board, 0.3))
    for more in MORE[list(BOARDS).index(name) % 2 :: 2]:
        with named(more):
            other = CharucoBoard(columns=board.columns + more[0], rows=board.rows + more[1])
            assert make_detector(other).detect(one.image) is None


def test_another_board_of_the_same_dictionary_beside_it_hides_no_board():
    one = drawn(BOARDS["6x4"], z=1.0)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    other = cv2.aruco.CharucoBoard((3, 4), 0.04, 0.03, markers, np.arange(12, 18))
    image = one.image.copy()
    image[10:170, 10:130] = other.generateImage((120, 160))
    found = detector_of(BOARDS["6x4"]).detect(image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.25)


def test_a_board_is_tracked_and_a_copy_through_pickle_says_the_same():
    board = BOARDS["7x5"]
    one, other, detector = drawn(board, 0.3), drawn(board, 0.31, 0.79), detector_of(BOARDS["7x5"])
    before = pickle.loads(pickle.dumps(detector)).detect(one.image)
    np.testing.assert_array_equal(before.corners_px, detector.detect(one.image).corners_px)
    found = detector.track(other.image, before)
    assert found.corners_px == pytest.approx(other.corners, abs=0.25)

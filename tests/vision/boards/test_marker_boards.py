"""ChArUco boards of both layouts and AprilGrids, whole or in part; hidden corners are nan."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import Change, Scene, cropped, glare, jpeg, ramp, rig, rms, scene, shadow
from vergence.models.camera import Lens, camera_matrix
from vergence.models.parts import Rendering
from vergence.vision import AprilGrid, Camera, CharucoBoard, TagFamily, make_detector

BOARDS = {
    "7x5": CharucoBoard(columns=7, rows=5),
    "6x4": CharucoBoard(columns=6, rows=4),
    "6x4 legacy": CharucoBoard(columns=6, rows=4, legacy=True),
    "5x6 legacy": CharucoBoard(columns=5, rows=6, legacy=True),
    "8x5 5X5": CharucoBoard(columns=8, rows=5, marker_m=0.026, dictionary="DICT_5X5_100"),
}
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


def charuco(board: CharucoBoard, roll: float = 0.0, z: float = 0.8, x: float = 0.013) -> Scene:
    camera, rendering = rig("simulated")
    T_C_T = pose(x, -0.021, z) @ pose(0, 0, 0, (0, 0, roll)) @ pose(0, 0, 0, (0.2, -0.2, 0))
    return scene(camera, board, T_C_T, rendering, np.random.default_rng(1))


def grid(
    z: float = 0.5,
    turn: tuple[float, float, float] = (0.3, -0.2, 0.0),
    camera: Camera = PINHOLE,
    x: float = 0.0,
    blur_px: float = 0.7,
) -> Scene:
    rendering = replace(RENDERING, blur_px=blur_px)
    return scene(camera, GRID, pose(x, 0.01, z, turn), rendering, np.random.default_rng(1))


def detector_of(target: CharucoBoard | AprilGrid):
    return make_detector(target, None if target == GRID else rig("simulated")[0])


KINDS = {"charuco": BOARDS["7x5"], "aprilgrid": GRID}


def whole(name: str) -> Scene:
    return grid() if name == "aprilgrid" else charuco(BOARDS["7x5"], 0.3)


@pytest.mark.parametrize(
    ("name", "side", "grey"),
    [
        ("charuco", (1, 0), 0), ("charuco", (0, -1), 255), ("charuco", (0.7, 0.7), 120),
        ("aprilgrid", (0.8, 0.6), 120),
    ],
)  # fmt: skip
def test_hidden_corners_are_nan_and_the_others_where_they_are(name, side, grey):
    """Half of the board is behind a hand; the middle is known by the other half."""
    one, edge_px = whole(name), 8.0 if name == "charuco" else 20.0
    v, u = np.indices(one.image.shape)
    beyond = (u - one.point[0]) * side[0] + (v - one.point[1]) * side[1]
    hidden = np.where(beyond > edge_px, grey, one.image).astype(np.uint8)
    found = detector_of(KINDS[name]).detect(hidden)
    there = np.isfinite(found.corners_px).all(axis=1)
    across = (one.corners - one.point) @ side
    assert there.sum() >= 6
    assert not there[across > edge_px].any()
    np.testing.assert_array_equal(np.isfinite(found.corners_sigma_px).all(axis=1), there)
    if name == "charuco":
        inside = there & (across < 0.0)
        assert np.isfinite(found.sigma_px).all()
        assert found.point_px == pytest.approx(one.point, abs=0.3)
    else:  # what covers the board ends in the windows of some
        inside = there
        assert there.sum() > 0.6 * (across < 10.0).sum()
    assert found.corners_px[inside] == pytest.approx(one.corners[inside], abs=0.25)


@pytest.mark.parametrize(
    ("name", "least", "most_px"), [("charuco", 4, 0.25), ("aprilgrid", 8, 0.15)]
)
def test_a_board_that_the_images_edge_cuts_is_found_in_part(name, least, most_px):
    one = grid(x=-0.3) if name == "aprilgrid" else charuco(BOARDS["7x5"], x=-0.67)
    found = detector_of(KINDS[name]).detect(one.image)
    there = np.isfinite(found.corners_px).all(axis=1)
    assert least <= there.sum() < len(there)
    assert not there[one.corners[:, 0] < 0.0].any()
    assert found.corners_px[there] == pytest.approx(one.corners[there], abs=most_px)


LIGHTS: dict[str, dict[str, Change]] = {
    "charuco": {
        "half shadow": shadow(0.5, 0.5), "ramp": ramp(0.2, 0.5, 250.0),
        "glare": glare(210.0, 40.0), "JPEG of quality 30": jpeg(30),
    },
    "aprilgrid": {"shadow": shadow(0.5), "ramp": ramp(0.2), "JPEG of quality 30": jpeg(30)},
}  # fmt: skip


@pytest.mark.parametrize("name", ["charuco", pytest.param("aprilgrid", marks=pytest.mark.slow)])
def test_light_and_files_move_the_corners_found_by_little(name):
    one = whole(name)
    for kind, change in LIGHTS[name].items():
        with named(kind):
            found = detector_of(KINDS[name]).detect(change(one.image, one.point))
            errors = found.corners_px - one.corners
            there = np.isfinite(errors).all(axis=1)
            assert np.median(np.abs(errors[there])) < 0.1
            if name == "charuco":
                assert there.sum() >= 12
                assert rms(errors[there]) < 2.0 * rms(found.corners_sigma_px[there])
            else:
                assert there.mean() > 0.8
                assert np.abs(errors[there]).max() < 1.5


@pytest.mark.parametrize("name", KINDS)
def test_a_board_is_tracked_and_a_copy_through_pickle_says_the_same(name):
    detector, one = detector_of(KINDS[name]), whole(name)
    if name == "aprilgrid":
        other = grid(z=0.505, turn=(0.3, -0.2, 0.01))
    else:
        other = charuco(BOARDS["7x5"], 0.31, 0.79)
    before = pickle.loads(pickle.dumps(detector)).detect(one.image)
    np.testing.assert_array_equal(before.corners_px, detector.detect(one.image).corners_px)
    found = detector.track(other.image, before)
    assert found.corners_px == pytest.approx(other.corners, abs=0.25 if name == "charuco" else 0.15)


def test_every_corner_is_found_in_the_boards_order():
    """OpenCV's, of a ChArUco board."""
    for roll, name in some_of([0.0, 0.8, np.pi / 2, np.pi, -2.2], [*BOARDS, "grid"]):
        with named(roll, name):
            one = grid(turn=(0.0, 0.0, roll)) if name == "grid" else charuco(BOARDS[name], roll)
            detector = detector_of(BOARDS.get(name, GRID))
            found = detector.detect(one.image)
            assert found.target == detector.target
            assert found.corners_px == pytest.approx(one.corners, abs=0.25)
            assert rms(found.corners_px - one.corners) < 0.08
            assert found.point_px == pytest.approx(one.point, abs=0.05)


def test_a_board_of_the_old_layout_need_not_be_called_that():
    board, asked = BOARDS["6x4 legacy"], BOARDS["6x4"]
    one = charuco(board, 0.3)
    found = detector_of(asked).detect(one.image)
    assert found.target == board
    assert found.corners_px == pytest.approx(one.corners, abs=0.25)
    tracked = detector_of(asked).track(one.image, found)
    assert tracked.target == board


def test_a_board_of_the_new_layout_is_none_where_the_old_one_was_asked_for():
    one = charuco(BOARDS["6x4"], 0.3)
    assert detector_of(BOARDS["6x4 legacy"]).detect(one.image) is None


@pytest.mark.parametrize("z", [0.6, 1.2])
def test_sigmas_of_a_charuco_board_hold_the_errors(z):
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


def test_another_board_and_a_mirrored_one_are_none():
    for one, board, others in (
        (
            cropped(charuco(BOARDS["7x5"])),
            BOARDS["7x5"],
            [{"dictionary": "DICT_5X5_50"}, {"dictionary": "DICT_6X6_50"}],
        ),
        (grid(), GRID, [{"columns": 4, "rows": 5}, {"rows": 3}, {"spacing": 0.25}]),
    ):
        for change in others:
            with named(change):
                assert make_detector(replace(board, **change)).detect(one.image) is None
        assert make_detector(board).detect(np.ascontiguousarray(one.image[:, ::-1])) is None


@pytest.mark.parametrize("name", ["7x5", "6x4 legacy"])
def test_a_board_of_similar_counts_is_none(name):
    """A part of the markers is where the board asked for has them, others beside it."""
    board = BOARDS[name]
    one = cropped(charuco(board, 0.3))
    for more in ((0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1), (2, 0), (-2, 0)):
        with named(more):
            other = CharucoBoard(columns=board.columns + more[0], rows=board.rows + more[1])
            assert make_detector(other).detect(one.image) is None


def test_another_board_of_the_same_dictionary_beside_it_hides_no_board():
    one = charuco(BOARDS["6x4"], z=1.0)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    other = cv2.aruco.CharucoBoard((3, 4), 0.04, 0.03, markers, np.arange(12, 18))
    image = one.image.copy()
    image[10:170, 10:130] = other.generateImage((120, 160))
    found = detector_of(BOARDS["6x4"]).detect(image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.25)


@pytest.mark.parametrize(("z", "blur_px"), [(0.5, 0.5), (0.5, 1.5), (1.2, 0.5)])
def test_sigmas_of_a_grid_hold_the_errors(z, blur_px):
    """Also of tags of 22 px, whose bits have 2."""
    one = grid(z=z, blur_px=blur_px)
    found = make_detector(GRID).detect(one.image)
    errors = found.corners_px - one.corners
    assert np.isfinite(errors).all()
    assert 0.8 < rms(errors / found.corners_sigma_px) < 1.25
    assert rms(errors) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_a_wide_lens_hides_no_corner_that_it_bends(known):
    """The board reaches 50 degrees off the axis."""
    one = grid(z=0.18, turn=(0.1, 0.2, 0.3), camera=FISHEYE)
    detector = make_detector(GRID, FISHEYE if known else None)
    found = detector.detect(one.image)
    errors = found.corners_px - one.corners
    there = np.isfinite(errors).all(axis=1)
    inside = ((one.corners > 3.0) & (one.corners < (636.0, 476.0))).all(axis=1)
    assert there.sum() >= (0.99 if known else 0.9) * inside.sum()
    assert np.abs(errors[there]).max() < 0.2
    assert rms(errors[there] / found.corners_sigma_px[there]) < 1.3
    assert detector.track(np.full_like(one.image, 120), found) is None


def test_a_board_that_is_hidden_in_part_is_tracked_and_comes_back():
    detector, one = make_detector(GRID), grid()
    hidden = one.image.copy()
    hidden[:, int(one.point[0]) :] = 120
    found = detector.track(hidden, detector.detect(one.image))
    assert 0.3 < np.isfinite(found.corners_px[:, 0]).mean() < 0.6
    assert np.isfinite(detector.track(one.image, found).corners_px).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turn", "columns", "rows"), [((0.0, 0.0, 0.0), 3, 1), ((0.6, 0.3, 1.0), 10, 10)]
)
def test_a_row_that_other_counts_share_is_not_taken_for_their_board(turn, columns, rows):
    """The first row has the numbers of any wider board; a hand hides a part of it."""
    image = grid(turn=turn, z=0.4).image.copy()
    image[:, :200] = 120
    other = AprilGrid(columns=columns, rows=rows, tag_m=0.05)
    assert make_detector(other).detect(image) is None
    for way in range(3):
        assert make_detector(other).search(image, way=way) is None
    assert make_detector(GRID).detect(image) is not None


def test_a_tag_of_another_board_on_the_grid_hides_no_board():
    one = grid(turn=(0.0, 0.0, 0.0))
    image, tags = one.image.copy(), np.rint(one.corners.reshape(-1, 4, 2)).astype(int)
    (u, v), (u_end, v_end) = tags[7, 0], tags[7, 2]
    stray = cv2.resize(GRID.tag_bits(300), (u_end - u, v_end - v), interpolation=cv2.INTER_AREA)
    image[v:v_end, u:u_end] = np.clip(stray, 40, 210)
    found = make_detector(GRID).detect(image)
    assert np.isfinite(found.corners_px).all(axis=1).sum() >= len(one.corners) - 4


@pytest.mark.slow
def test_no_tag_of_it_is_taken_for_a_single_one_with_a_border_of_one_bit():
    """The inside of its border reads like one, of 4/5 of the size."""
    near = grid(z=0.15, turn=(0.1, -0.1, 0.05))
    assert make_detector(TagFamily(family="36h11")).detect_all(near.image) == []

"""Checkerboards of every size: whole ones, in order, in uneven light; no other board."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.grids import some_of
from tests.models.lenses import wide
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import (
    Scene,
    cropped,
    defocus,
    glare,
    jpeg,
    ramp,
    rig,
    rms,
    scene,
    shadow,
    turned,
)
from vergence.models.camera import camera_matrix
from vergence.models.parts import Rendering
from vergence.vision import BoardDetection, Camera, Checkerboard, make_detector


def board(columns: int, rows: int, square_px: float = 20.0, *, rim: bool = True) -> Checkerboard:
    """Checkerboard with squares of a size at 1 m before the simulated rig."""
    square_m = 0.0323 * square_px / 20.0
    return Checkerboard(columns=columns, rows=rows, square_m=square_m, white_rim=rim)


def drawn(
    target: Checkerboard,
    roll: float = 0.0,
    turn: tuple[float, float] = (0.0, 0.0),
    *,
    z: float = 1.0,
    rendering: Rendering | None = None,
) -> Scene:
    """The board's middle near the axis of the simulated rig."""
    camera, plain = rig("simulated")
    middle = target.corners_m.mean(axis=0)
    T_C_T = (
        pose(0.013, -0.021, z)
        @ pose(0, 0, 0, (0, 0, roll))
        @ pose(0, 0, 0, (*turn, 0))
        @ pose(-middle[0], -middle[1], 0)
    )
    return scene(camera, target, T_C_T, rendering or plain, np.random.default_rng(1))


def detector_of(target: Checkerboard):
    return make_detector(target, rig("simulated")[0])


@pytest.mark.slow
def test_a_board_without_a_rim_is_found_before_a_dark_and_before_a_light_wall():
    """Before a wall of the grey of its black squares or of its white ones."""
    for surround, size, roll in [(45.0, (5, 4), 0.5), (205.0, (9, 6), 0.5), (45.0, (9, 6), 0.0)]:
        rendering = replace(rig("simulated")[1], background_grey=surround)
        target = board(*size, rim=False)
        with named(surround, size, roll):
            one = drawn(target, roll, (0.1, 0.2), rendering=rendering)
            found = detector_of(target).detect(one.image)
            assert found.corners_px == pytest.approx(one.corners, abs=0.12)


@pytest.mark.slow
def test_a_board_that_tells_up_from_down_has_its_corners_in_order_at_every_roll():
    sizes = [(5, 4), (4, 5), (9, 6), (12, 9)]
    for rim, roll, size in some_of([True, False], [0.0, 0.7, np.pi / 2, np.pi, -2.0], sizes):
        with named(rim, roll, size):
            target = board(*size, rim=rim)
            one = drawn(target, roll, (0.3, -0.4))
            found = detector_of(target).detect(one.image)
            assert found.target == target
            assert rms(found.corners_px - one.corners) < 0.08
            assert found.corners_px == pytest.approx(one.corners, abs=0.2)
            assert found.point_px == pytest.approx(one.point, abs=0.2)


@pytest.mark.parametrize(
    ("roll", "size"), [(0.0, (3, 3)), (1.4, (5, 5)), (-2.0, (5, 3)), (np.pi, (4, 4)), (0.7, (6, 4))]
)
def test_a_symmetric_boards_first_line_points_to_the_right(size, roll):
    """Its corners are those that are drawn, in one of its orders; its point is the middle."""
    columns, rows = size
    target = board(columns, rows)
    one = drawn(target, roll, (0.1, -0.1))
    found = detector_of(target).detect(one.image)
    assert found.point_px == pytest.approx(one.point, abs=0.15)
    true = one.corners.reshape(rows, columns, 2)
    orders = [true, true[::-1, ::-1]]
    if columns == rows and columns % 2 == 0:  # in a quarter turn, odd boards change their colours
        orders += [np.rot90(true), np.rot90(true, -1)]
    matched = min(orders, key=lambda each: rms(found.corners_px - each.reshape(-1, 2)))
    assert found.corners_px == pytest.approx(matched.reshape(-1, 2), abs=0.2)
    assert (matched[0, -1] - matched[0, 0])[0] > 0


@pytest.mark.parametrize(
    ("size", "orders"),
    [
        ((4, 4), [lambda true: true]), ((6, 4), [lambda true: true]),  # with white corners
        # turned by a quarter, and by a half
        ((3, 3), [lambda true: np.rot90(true, 1), lambda true: np.rot90(true, 3)]),
        pytest.param((5, 4), [lambda true: true[::-1, ::-1]], marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_board_printed_the_other_way_round_is_found(size, orders):
    """A symmetric one has the same corners; others look like themselves turned."""
    target = board(*size)
    one = cropped(drawn(target, 0.1, (0.2, 0.1)))
    found = make_detector(target).detect(255 - one.image)
    true = one.corners.reshape(target.rows, target.columns, 2)
    beside = [np.abs(found.corners_px - order(true).reshape(-1, 2)).max() for order in orders]
    assert min(beside) < 0.2
    assert make_detector(target).track(255 - one.image, found) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("roll", "rim", "asked", "shown"),
    [
        (0.9, False, (5, 4), (5, 5)), (2.0, True, (3, 3), (5, 4)), (2.0, False, (6, 4), (7, 5)),
        (0.9, True, (6, 4), (5, 4)), (0.0, True, (5, 5), (5, 4)),
    ],
)  # fmt: skip
def test_a_part_of_a_larger_board_and_a_smaller_one_are_none(asked, shown, rim, roll):
    one = cropped(drawn(board(*shown, rim=rim), roll, (0.1, 0.1)))
    detector = make_detector(board(*asked))
    assert detector.detect(one.image) is None
    if np.prod(asked) < np.prod(shown):
        assert detector.track(one.image, part_of(one, shown, detector)) is None


def predicted(target: Checkerboard, corners: np.ndarray) -> BoardDetection:
    """A board with corners, (n, 2) px, in the order of its own."""
    point = corners[target.columns - 1]
    return BoardDetection(target, point, corners, np.ones(2), np.ones(corners.shape))


def part_of(one: Scene, shown: tuple[int, int], detector) -> BoardDetection:
    """The first corners of a board, as if they were those of a smaller one."""
    columns, rows = detector.target.columns, detector.target.rows
    part = one.corners.reshape(shown[1], shown[0], 2)[:rows, :columns].reshape(-1, 2)
    return predicted(detector.target, part)


def beyond(image: np.ndarray, corners: np.ndarray, greys: tuple[float, float]) -> np.ndarray:
    """Two greys by turns below a board's corners, (rows, columns, 2), as if squares followed."""
    out, step = image.copy(), corners[-1] - corners[-2]
    for i, (a, b) in enumerate(zip(corners[-1, :-1], corners[-1, 1:], strict=True)):
        along = step[i : i + 2]
        quad = np.stack(
            [a + 1.1 * along[0], b + 1.1 * along[1], b + 2 * along[1], a + 2 * along[0]]
        )
        cv2.fillConvexPoly(out, np.rint(quad).astype(np.int32), greys[i % 2])
    return out


def test_a_keyboard_below_the_board_is_no_more_of_it():
    """It alternates where squares would follow, by less than they do."""
    target = board(9, 6)
    one = drawn(target, 0.1, (0.1, 0.2))
    corners = one.corners.reshape(6, 9, 2)
    found = detector_of(target).detect(beyond(one.image, corners, (97, 160)))
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


def outline(grid: np.ndarray, share: float) -> np.ndarray:
    """Outline of a board whose outermost squares are cut to a fraction, (4, 2) px."""
    grid = np.stack(
        [grid[0] + share * (grid[0] - grid[1]), grid[-1] + share * (grid[-1] - grid[-2])]
    )
    left = grid[:, 0] + share * (grid[:, 0] - grid[:, 1])
    right = grid[:, -1] + share * (grid[:, -1] - grid[:, -2])
    return np.stack([left[0], right[0], right[1], left[1]])


@pytest.mark.parametrize("asked", [(8, 6), (9, 5)], ids=str)
def test_a_board_whose_outermost_squares_are_cut_is_no_smaller_one(asked):
    """OpenCV's own sample has such boards."""
    one = drawn(board(9, 6), 0.1, (0.1, 0.2))
    grid = one.corners.reshape(6, 9, 2)
    shown = np.zeros_like(one.image)
    cv2.fillConvexPoly(shown, np.rint(outline(grid, 0.4)).astype(np.int32), 255)
    image = np.where(shown > 0, one.image, 205).astype(np.uint8)
    assert detector_of(board(9, 6)).detect(image) is not None
    detector = detector_of(board(*asked))
    assert detector.track(image, part_of(one, (9, 6), detector)) is None


@pytest.mark.slow
@pytest.mark.parametrize(("side", "size"), [((1, 0), (5, 4)), ((0, 1), (9, 6))])
def test_a_half_hidden_board_is_none_neither_found_nor_tracked(size, side):
    target = board(*size)
    one = cropped(drawn(target, 0.2))
    detector = make_detector(target)
    seen = detector.detect(one.image)
    middle = one.corners.mean(axis=0)
    v, u = np.indices(one.image.shape)
    beyond = (u - middle[0]) * side[0] + (v - middle[1]) * side[1] > 0
    hidden = np.where(beyond, 90, one.image).astype(np.uint8)
    assert detector.detect(hidden) is None
    assert detector.track(hidden, seen) is None


@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (6, 4)])
def test_the_mirror_image_of_a_board_is_a_board_in_its_own_order(columns, rows):
    """A mirrored board that tells up from down looks like itself turned: corners lie in order."""
    target = board(columns, rows)
    image = np.ascontiguousarray(drawn(target, 0.1).image[:, ::-1])
    found = detector_of(target).detect(image)
    grid = found.corners_px.reshape(rows, columns, 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert along[0] * down[1] - along[1] * down[0] > 0


LIGHTS = {
    "ramp": ramp(0.2, 0.5, 200.0), "ramp down": ramp(0.2, 1.6, 200.0),
    "glare beside": glare(230.0, 40.0, 0.5), "glare above": glare(230.0, 40.0, 4.5),
    "JPEG of quality 30": jpeg(30), "out of focus": defocus(1.5),
}  # fmt: skip


@pytest.mark.slow
def test_light_and_files_move_no_corner():
    for what, size in some_of(list(LIGHTS), [(5, 4), (9, 6), (5, 5)]):
        with named(what, size):
            target = board(*size)
            one = drawn(target, 0.1, (0.3, -0.2))
            image = LIGHTS[what](one.image, one.corners.mean(axis=0))
            detector = detector_of(target)
            found = detector.detect(image)
            assert rms(found.corners_px - one.corners) < 0.15
            assert detector.track(image, found) is not None


@pytest.mark.slow
def test_the_edge_of_a_shadow_moves_no_corner_far():
    """It runs through windows of 11 px and moves corners by 3 px that nobody looks after.

    Half are moved by less than 0.1 px, in deep shadow too; those it crosses are in the sigma.
    """
    deep = [(0.3, 0.0, (5, 5)), (0.3, 0.5, (5, 4)), (0.3, 2.0, (9, 6))]
    half = [(0.5, *each) for each in some_of([0.0, 0.5, 1.2, 2.0, 2.8], [(5, 4), (9, 6), (5, 5)])]
    for left, angle, size in deep + half:
        with named(left, angle, size):
            one = cropped(drawn(board(*size), 0.1, (0.3, -0.2)))
            image = shadow(left, angle)(one.image, one.corners.mean(axis=0))
            detector = make_detector(board(*size))
            found = detector.detect(image)
            if left == 0.3 and found is None:
                continue
            errors = found.corners_px - one.corners
            assert np.median(np.abs(errors)) < 0.1
            assert rms(errors) < 2.0 * rms(found.corners_sigma_px) + 0.05
            if left == 0.5:
                assert np.abs(errors).max() < 1.2
                assert rms(errors) < 0.3
                assert detector.track(image, found) is not None


@pytest.mark.parametrize(("grey", "corner"), [(0, 0), (90, 13), (255, 30)])
def test_a_blob_on_a_corner_leaves_it_where_it_is_or_the_board_is_none(corner, grey):
    """A sticker, a clip, a drop: it covers a corner, and its squares stay readable."""
    target = board(9, 6)
    one = cropped(drawn(target, 0.1, (0.2, -0.2)))
    for aside in ((0.0, 0.0), (2.5, 1.0), (-3.0, 3.0)):
        image = one.image.copy()
        place = tuple(np.rint(one.corners[corner] + aside).astype(int).tolist())
        cv2.circle(image, place, 4, grey, -1, cv2.LINE_AA)
        found = make_detector(target).detect(image)
        if found is not None:
            beside = np.abs(found.corners_px - one.corners)
            assert np.delete(beside, corner, axis=0).max() < 0.6
            assert (beside[corner] < 0.5 + 4.0 * found.corners_sigma_px[corner]).all()


def test_a_prediction_between_the_corners_finds_no_board_there():
    """OpenCV leaves a corner where it was that would leave its window, as if it were refined."""
    target = board(5, 4)
    one, detector = drawn(target, 0.1), detector_of(target)
    seen = detector.detect(one.image)
    for share, along in some_of([0.15, 0.25, 0.4, 0.5], [(1.0, 0.0), (0.0, -1.0), (0.7, 0.7)]):
        with named(share, along):
            by_px = share * 20.0 * np.array(along)
            wrong = seen._replace(
                corners_px=seen.corners_px + by_px, point_px=seen.point_px + by_px
            )
            found = detector.track(one.image, wrong)
            assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "square_px", "most_px"),
    [("physical", 5.0, 0.12), ("simulated", 10.0, 0.08), ("simulated", 50.0, 0.08)],
)
def test_boards_are_found_as_exactly_as_said_at_every_place_in_the_pixel_grid(
    name, square_px, most_px
):
    """0.08 px rms of each coordinate with the rig's noise, unless squares are small."""
    camera, rendering = rig(name)
    target, rng = Checkerboard(columns=5, rows=4), np.random.default_rng(4)
    detector = make_detector(target, camera)
    z = target.square_m * camera.focal[0] / square_px
    errors = []
    place, turn_rad = (0.1, 0.3) if square_px < 10.5 else (0.05, 0.5)
    for _ in range(5):
        x, y = rng.uniform(-place, place, 2) * z
        one = scene(camera, target, pose(x, y, z, turned(rng, turn_rad)), rendering, rng)
        errors.append(detector.detect(one.image).corners_px - one.corners)
    assert rms(errors) < most_px


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "columns", "rows", "z"), [(2.0, 5, 4, 0.7), (6.0, 9, 6, 1.5)])
def test_sigmas_are_not_less_than_the_scatter(columns, rows, noise, z):
    """Nor more than the error's own size, which they hold as well: the grid of pixels' share.

    Over 15 images with the board at places anywhere in the pixel grid.
    """
    camera, plain = rig("simulated")
    rendering = replace(plain, noise_grey=noise)
    target, rng = board(columns, rows), np.random.default_rng(5)
    detector = make_detector(target, camera)
    errors, said, scatter = [], [], []
    for _ in range(5):
        x, y = rng.uniform(-0.05, 0.05, 2)
        T_C_T = pose(x, y, z, turned(rng, 0.3))
        same = []
        for _ in range(3):
            one = scene(camera, target, T_C_T, rendering, rng)
            found = detector.detect(one.image)
            same.append(found.corners_px)
            errors.append(found.corners_px - one.corners)
            said.append(found.corners_sigma_px)
        scatter.append(rms(np.std(same, axis=0, ddof=1)))
    assert 0.7 * rms(scatter) < rms(said)
    assert 0.6 * rms(errors) < rms(said) < 1.7 * rms(errors)


@pytest.mark.parametrize("uneven_px", [0.3, 0.6])
def test_an_unevenly_printed_board_says_so(uneven_px):
    """Paper that waves by so much moves corners; the sigma says by how much, to a third."""
    target = board(9, 6)
    one = cropped(drawn(target, 0.05, (0.1, 0.1), z=0.6))
    rng, said, errors = np.random.default_rng(6), [], []
    for _ in range(3):
        # waves of about a square, so that neighbours move by themselves
        small = rng.normal(size=(2, 24, 32)).astype(np.float32)
        height, width = one.image.shape
        shifts = [
            cv2.resize(each, (width, height), interpolation=cv2.INTER_CUBIC) for each in small
        ]
        shifts = [uneven_px * each / each.std() for each in shifts]
        v, u = np.indices(one.image.shape, np.float32)
        image = cv2.remap(one.image, u + shifts[0], v + shifts[1], cv2.INTER_CUBIC)
        found = make_detector(target).detect(image)
        said.append(found.corners_sigma_px)
        errors.append(found.corners_px - one.corners)
    assert rms(said) == pytest.approx(rms(errors), rel=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("aside_deg", [0.0, 50.0])
def test_a_board_seen_through_a_fisheye_is_not_called_uneven(aside_deg):
    """Its corners are where they are, and sigmas do not take the lens's bend for scatter."""
    camera = Camera.of(wide("fisheye"), 0)
    _, rendering = rig("physical")
    target, side = board(9, 6), np.deg2rad(aside_deg)
    detector, rng = make_detector(target, camera), np.random.default_rng(7)
    middle = target.corners_m.mean(axis=0)
    T_C_T = pose(0.6 * np.sin(side), 0.0, 0.6 * np.cos(side), (0.0, side, 0.0)) @ pose(
        -middle[0], -middle[1], 0
    )
    one = scene(camera, target, T_C_T, rendering, rng)
    found = detector.detect(one.image)
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)
    assert rms(found.corners_sigma_px) < 0.1


def test_a_board_in_a_large_photograph_is_found_as_exactly():
    """Squares are looked for in a reduced image, and corners refined in the whole one.

    Out of focus, their edges are wider than the windows for corners of small squares.
    """
    camera = Camera(size=(4000, 3000), matrix=camera_matrix((3000.0, 3000.0), (1999.5, 1499.5)))
    target = board(9, 6)
    one = scene(camera, target, pose(0.1, 0.05, 0.9, (0.2, 0.2, 0.1)), rig("simulated")[1])
    detector = make_detector(target, camera)
    assert rms(detector.detect(one.image).corners_px - one.corners) < 0.05
    blurred = detector.detect(defocus(5.0)(one.image, one.point))
    assert rms(blurred.corners_px - one.corners) < 0.1


def test_the_outer_corner_of_a_square_is_not_taken_for_one_where_four_meet():
    target = board(9, 6)
    one, detector = drawn(target, 0.1), detector_of(target)
    seen = detector.detect(one.image)
    wrong = seen.corners_px.copy()
    wrong[0] = 2.0 * wrong[0] - wrong[10]  # across the outermost square
    found = detector.track(one.image, seen._replace(corners_px=wrong))
    assert found.corners_px == pytest.approx(seen.corners_px, abs=0.1)


def blocks(cell_px: int, shape: tuple[int, int]) -> np.ndarray:
    """Black and white squares by chance: corners everywhere, and no board."""
    rows, columns = shape
    cells = np.random.default_rng(4).integers(0, 2, (rows // cell_px + 1, columns // cell_px + 1))
    large = np.kron(cells, np.ones((cell_px, cell_px), int))[:rows, :columns]
    return (40 + 180 * large).astype(np.uint8)


@pytest.mark.parametrize("way", [None, 0])
def test_a_board_among_blocks_is_found(way):
    target = board(9, 6)
    one = drawn(target, 0.2, (0.0, 0.3))
    image, room = blocks(10, one.image.shape), 70
    x0, y0 = np.floor(one.corners.min(axis=0) - room).astype(int).clip(0)
    x1, y1 = np.ceil(one.corners.max(axis=0) + room).astype(int)
    image[y0:y1, x0:x1] = one.image[y0:y1, x0:x1]
    found = detector_of(target).search(image, None, way)
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.slow
def test_small_squares_are_found_in_the_turn_that_looks_at_the_whole_image():
    target = board(9, 6, 11.0)
    one, detector = drawn(target, 0.2, (0.0, 0.3)), make_detector(target)
    wide = cv2.copyMakeBorder(one.image, 0, 900, 0, 1160, cv2.BORDER_REPLICATE)
    assert detector.search(wide, None, 0) is None
    for way in (None, 1):
        found = detector.search(wide, None, way)
        assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.parametrize("way", [None, 3])
def test_a_board_out_of_focus_is_found_in_a_small_image(way):
    target = board(4, 3, 80.0)
    one = drawn(target, 0.2, (0.0, 0.3))
    blurred = defocus(9.0)(one.image, one.point)
    found = detector_of(target).search(blurred, None, way)
    assert np.abs(found.corners_px - one.corners).max() < 1.0


@pytest.mark.parametrize("size", [(6, 4), (4, 4)])
def test_a_mirrored_prediction_is_not_tracked_in_its_order(size):
    """A symmetric board reads the same in it, but no camera shows it so."""
    target = board(*size)
    one = cropped(drawn(target, 0.1))
    mirrored = one.corners.reshape(*size[::-1], 2)[:, ::-1].reshape(-1, 2)
    found = make_detector(target).track(one.image, predicted(target, mirrored))
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


@pytest.mark.parametrize(
    ("corner", "grey", "radius_px", "aside"),
    [(0, 90, 10, (-4, 4)), (0, 0, 4, (3, 1)), (53, 205, 10, (6, 1))],
)
def test_a_corner_beside_a_spot_is_within_its_sigma_or_the_board_is_none(
    corner, grey, radius_px, aside
):
    """Whether the spot hides it, pulls it aside, or leaves a crossing of other edges."""
    target = board(9, 6)
    one = cropped(drawn(target, 0.1, (0.2, -0.2)))
    place = tuple(np.rint(one.corners[corner] + aside).astype(int).tolist())
    image = cv2.circle(one.image.copy(), place, radius_px, grey, -1, cv2.LINE_AA)
    found = make_detector(target).track(image, predicted(target, one.corners))
    if found is not None:
        errors = np.abs(found.corners_px - one.corners)
        assert (errors < 0.05 + 6.0 * found.corners_sigma_px).all()


def test_a_corner_found_again_has_the_sigma_of_its_place():
    """Not of the place beside it, where fewer edges hold it: that is 20 times as large."""
    target = board(5, 4)
    one, detector = cropped(drawn(target, 0.1)), make_detector(target)
    wrong = one.corners.copy()
    wrong[7] += (8.4, 8.4)
    found = detector.track(one.image, predicted(target, wrong))
    usual = detector.track(one.image, predicted(target, one.corners))
    assert found.corners_sigma_px == pytest.approx(usual.corners_sigma_px, rel=0.1)


def test_corners_left_where_they_were_predicted_are_not_taken_for_refined():
    """All but the middle one are too far off for their windows."""
    target = board(3, 3, 60.0)
    one = cropped(drawn(target, 0.1))
    wider = one.corners.mean(axis=0) + 1.1 * (one.corners - one.corners.mean(axis=0))
    found = make_detector(target).track(one.image, predicted(target, wider))
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


def test_a_board_that_ripples_by_a_tenth_of_a_square_is_none():
    """No smooth grid holds its corners to 2 px, nor would any sigma be of use."""
    target = board(5, 5)
    one, rng = cropped(drawn(target, 0.1)), np.random.default_rng(0)
    height, width = one.image.shape
    small = rng.normal(size=(2, height // 20, width // 20)).astype(np.float32)
    shifts = [cv2.resize(each, (width, height), interpolation=cv2.INTER_CUBIC) for each in small]
    u, v = (2.0 * each / each.std() for each in shifts)
    rows, columns = np.indices(one.image.shape, np.float32)
    image = cv2.remap(one.image, columns + u, rows + v, cv2.INTER_CUBIC)
    assert make_detector(target).track(image, predicted(target, one.corners)) is None


def test_a_symmetric_board_that_moved_keeps_its_order():
    """A search would begin at its other end; the prediction is off by a third of a square."""
    target = board(4, 4)
    one = cropped(drawn(target, 3.0))
    found = make_detector(target).track(one.image, predicted(target, one.corners + (0.0, 6.5)))
    assert found.corners_px == pytest.approx(one.corners, abs=0.2)


def test_a_board_of_small_squares_that_moved_is_found_as_exactly():
    """By half a square: refined from so far in its narrow window, it would be off by 0.2 px."""
    target = board(3, 3, 9.0)
    one = cropped(drawn(target, 2.1))
    found = make_detector(target).track(one.image, predicted(target, one.corners + (0.4, -4.8)))
    assert found.corners_px == pytest.approx(one.corners, abs=0.1)


def test_an_image_without_corners_shows_no_board():
    square = np.pad(np.full((30, 30), 200, np.uint8), 40)
    assert make_detector(board(5, 4)).detect(square) is None

"""Tags on bent paper: found, with a sigma that covers what the bend does to their corners."""

import cv2
import numpy as np
import pytest

from benchmarks.real_light import Scene, in_space, on_sheet
from tests.vision.scenes import levels, rms
from vergence.vision import TagFamily, make_detector
from vergence.vision.tag_families import tag_family

SIZE_M, HALF_M = 0.15, 0.075
IMAGE = (640, 480)
MIDDLE = 0.5 * np.array(IMAGE) - 0.5
FINER = 3
BLUR_PX = 0.5
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
FAMILY = TagFamily(family="36h11")
LINEAR = make_detector(FAMILY, response="linear")


def ray_pixels():
    """(height, width, 2) pixels of the rays of an image, from its middle."""
    u, v = (np.arange(n * FINER) / FINER + 0.5 / FINER - 0.5 for n in IMAGE)
    return np.stack(np.meshgrid(u, v), axis=-1) - MIDDLE


def bent_tag(seed, sagitta_m=None):
    """An image of a tag on a cylinder, its number, and its corners and centre.

    The cylinder bends 150 mm of paper by 4 to 7 mm, or as stated, about an axis that lies anywhere
    in its plane.
    """
    rng = np.random.default_rng(seed)
    focal, number = float(rng.choice([600.0, 900.0])), int(rng.integers(587))
    drawn_m = rng.uniform(0.004, 0.007)
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3)]))[0]
    pose[:3, 3] = [*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.4, 1.0)]
    bend_m, angle = drawn_m if sagitta_m is None else sagitta_m, rng.uniform(0.0, np.pi)
    scene = Scene(number, pose, BLUR_PX, bend_m, angle)
    seen = in_space(scene, HALF_M * np.array([*CORNERS, [0.0, 0.0]]))
    rays = np.pad(ray_pixels() / focal, ((0, 0), (0, 0), (0, 1)), constant_values=1.0)
    image = drawn_sheet(*on_sheet(scene, rays), number)
    image = levels(image + rng.normal(0.0, 1.5, image.shape))
    return image, number, focal * seen[:, :2] / seen[:, 2:] + MIDDLE


def drawn_sheet(paper, hit, number):
    """Image of the points of the paper, m, that the rays hit."""
    code = tag_family(FAMILY.family)
    cells = np.pad(code.cells(number), 1, constant_values=255) / 255.0
    place = np.floor(paper / (SIZE_M / code.width_at_border) + 0.5 * len(cells)).astype(int)
    there = ((place >= 0) & (place < len(cells))).all(axis=-1) & hit
    grey = np.full(there.shape, 110.0)
    grey[there] = 40.0 + 170.0 * cells[place[there][:, 1], place[there][:, 0]]
    return cv2.GaussianBlur(cv2.resize(grey, IMAGE, interpolation=cv2.INTER_AREA), (0, 0), BLUR_PX)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [29, 39])
def test_a_tag_on_bent_paper_is_found_with_a_sigma_that_covers_the_bend(seed):
    image, number, points = bent_tag(seed)
    corners, detector = points[:4], make_detector(FAMILY)
    found = next(one for one in detector.detect_all(image) if one.target.id == number)
    assert (np.abs(found.corners_px - corners) < 3.0 * found.corners_sigma_px).all()
    assert (found.corners_sigma_px < 0.02 * np.ptp(corners)).all()
    # the point lies between the four corners, which err by themselves
    assert found.sigma_px == pytest.approx(found.corners_sigma_px.mean(axis=0) / 2.0, rel=0.25)
    again = detector.track(image, found)
    assert np.abs(again.point_px - found.point_px).max() < 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("sagitta_m", [0.0, 0.004])
def test_the_point_of_a_bent_tag_is_the_middle_of_its_print(sagitta_m):
    """The crossing of its diagonals lies 0.3 px per mm beside it."""
    errors, sigmas = [], []
    for seed in (0, 6, 7):
        image, _, points = bent_tag(seed, sagitta_m)
        found = LINEAR.detect(image)
        errors.append(found.point_px - points[4])
        sigmas.append(found.sigma_px)
    errors, sigmas = np.array(errors), np.array(sigmas)
    assert (np.abs(errors) < 3.5 * sigmas).all()
    assert rms(errors / sigmas) < 1.3
    assert rms(errors) < 0.08
    assert rms(sigmas) < 0.01 + 60.0 * sagitta_m


@pytest.mark.slow
@pytest.mark.parametrize("along", [0, 1])
def test_the_corners_of_a_wavy_sheet_are_where_it_has_them(along):
    """The wave runs along one side, and shifts points along the other."""
    turn = np.array([[0.98, -0.2], [0.2, 0.98]])
    place = ray_pixels() @ turn.T / 60.0
    corners = np.linalg.solve(turn, 60.0 * CORNERS.T).T + MIDDLE
    other = place[..., 1 - along]
    place[..., along] += 0.03 * other * (1.0 - other**2)
    found = LINEAR.detect(levels(drawn_sheet(HALF_M * place, True, 5)))
    assert rms(found.corners_px - corners) < 0.1


def test_the_point_of_a_tag_with_a_trimmed_border_has_a_sigma_that_covers_both_middles():
    """No paper bends so far that the print's middle would lie there."""
    code = np.kron(tag_family(FAMILY.family).cells(5)[1:-1, 1:-1], np.ones((6, 6), np.uint8))
    image, black, trimmed = np.full((144, 144), 210, np.uint8), slice(48, 96), 4
    image[black, black] = np.where(code > 0, 210, 40)
    image[96 - trimmed :] = 210
    found = LINEAR.detect(cv2.GaussianBlur(image, (0, 0), 0.8))
    assert found.point_px == pytest.approx([71.5, 71.5 - 0.5 * trimmed], abs=0.2)
    assert (found.sigma_px > 0.5 * trimmed).all()

"""Tags on bent paper: found, with a sigma that covers what the bend does to their corners."""

import cv2
import numpy as np
import pytest

from vergence.models.tag_families import tag_family
from vergence.vision import TagFamily, make_detector
from vergence.vision.tags.library import find_squares

SIZE_M, HALF_M = 0.15, 0.075
IMAGE = (640, 480)
FINER = 3
GREYS = (40.0, 210.0)
FAMILY = TagFamily(family="36h11")
DETECTOR = make_detector(FAMILY)


def bent_tag(seed):
    """A sharp image of a tag on a cylinder, and its corners, px.

    The cylinder bends 150 mm of paper by 4 to 7 mm about an axis that lies anywhere in its plane.
    """
    rng = np.random.default_rng(seed)
    focal, number = float(rng.choice([600.0, 900.0])), int(rng.integers(587))
    sagitta_m = rng.uniform(0.004, 0.007)
    radius = HALF_M**2 / (2.0 * sagitta_m)
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3)]))[0]
    turn[:3, 3] = [*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.4, 1.0)]
    angle = rng.uniform(0.0, np.pi)
    along = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    middle = 0.5 * np.array(IMAGE) - 0.5

    u, v = (np.arange(n * FINER) / FINER + 0.5 / FINER - 0.5 for n in IMAGE)
    rays = np.stack([*np.meshgrid((u - middle[0]) / focal, (v - middle[1]) / focal)], axis=-1)
    rays = np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1) @ turn[:3, :3]
    eye = -turn[:3, :3].T @ turn[:3, 3]
    # the axis of the cylinder is along y, behind the paper
    rays[..., :2], eye[:2] = rays[..., :2] @ along.T, along @ eye[:2]
    away = eye[2] - radius
    a = rays[..., 0] ** 2 + rays[..., 2] ** 2
    b = eye[0] * rays[..., 0] + away * rays[..., 2]
    hit = b * b - a * (eye[0] ** 2 + away**2 - radius**2)
    t = (-b - np.sqrt(np.maximum(hit, 0.0))) / a
    x = radius * np.arctan2(eye[0] + t * rays[..., 0], radius - eye[2] - t * rays[..., 2])
    paper = np.stack([x, eye[1] + t * rays[..., 1]], axis=-1) @ along

    code = tag_family(FAMILY.family)
    cells = np.pad(code.cells(number), 1, constant_values=255) / 255.0
    place = np.floor(paper / (SIZE_M / code.border) + 0.5 * len(cells)).astype(int)
    there = ((place >= 0) & (place < len(cells))).all(axis=-1) & (hit > 0.0)
    grey = np.full(there.shape, 110.0)
    black, white = GREYS
    grey[there] = black + (white - black) * cells[place[there][:, 1], place[there][:, 0]]
    image = cv2.resize(grey, IMAGE, interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.5) + rng.normal(0.0, 1.5, image.shape)

    flat = HALF_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ along.T
    bent = np.column_stack(
        [radius * np.sin(flat[:, 0] / radius), flat[:, 1],
         radius * (1.0 - np.cos(flat[:, 0] / radius))]
    )  # fmt: skip
    bent[:, :2] = bent[:, :2] @ along
    seen = bent @ turn[:3, :3].T + turn[:3, 3]
    corners = focal * seen[:, :2] / seen[:, 2:] + middle
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), number, corners


def found_in(image, number):
    return next((one for one in DETECTOR.detect_all(image) if one.target.id == number), None)


@pytest.mark.parametrize(
    "seed", [29, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (8, 15, 39, 73))]
)
def test_a_tag_on_bent_paper_is_found_with_a_sigma_that_covers_the_bend(seed):
    image, number, corners = bent_tag(seed)
    assert number in [square.id for square in find_squares(image, FAMILY.family)]
    found = found_in(image, number)
    assert found is not None
    assert (np.abs(found.corners_px - corners) < 3.0 * found.corners_sigma_px).all()
    assert (found.corners_sigma_px < 0.02 * np.ptp(corners)).all()
    # the point lies between the four corners, which err by themselves
    assert found.sigma_px == pytest.approx(found.corners_sigma_px.mean(axis=0) / 2.0, rel=0.1)


@pytest.mark.slow
def test_such_a_tag_is_followed():
    image, number, _ = bent_tag(73)
    found = found_in(image, number)
    again = DETECTOR.track(image, found)
    assert again is not None
    assert np.abs(again.point_px - found.point_px).max() < 1.0

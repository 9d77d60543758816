"""Edges that look as if the camera's response were another than stated."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.vision.poses import pose
from tests.vision.scenes import levels, rig, scene
from vergence.models.camera import light_table
from vergence.perception.finding import TargetFinder
from vergence.perception.notes import LinearResponseCheck
from vergence.vision import make_planar_target


def image_of(name: str, response: str) -> np.ndarray:
    """A target near the eye, as a camera of a response sees it, in colours."""
    camera, rendering = rig("simulated")
    softer = replace(rendering, blur_px=0.9)
    rng = np.random.default_rng(2)
    drawn = scene(camera, make_planar_target(name), pose(0, 0, 0.6, (0.2, 0.3, 0.1)), softer, rng)
    encoded = np.interp(drawn.image, light_table(response), np.arange(256.0))
    return cv2.cvtColor(levels(encoded), cv2.COLOR_GRAY2BGR)


@pytest.mark.slow
def test_encoded_levels_that_are_taken_for_light_are_noticed():
    finder = TargetFinder([make_planar_target("checkerboard")], response="linear")
    assert finder.find(image_of("checkerboard", "srgb"))
    (line,) = finder.response_check.lines()
    assert "were srgb, not linear" in line


@pytest.mark.slow
@pytest.mark.parametrize("radius_px", [2.0, 2.5])
def test_a_lens_out_of_focus_is_no_response(radius_px):
    """It blurs to a disk, whose edges are no Gaussian's, and even all the same."""
    camera, rendering = rig("simulated")
    sharp = replace(rendering, blur_px=0.3)
    target = make_planar_target("checkerboard")
    drawn = scene(camera, target, pose(0, 0, 0.5, (0.2, 0.3, 0.1)), sharp, np.random.default_rng(2))
    side = np.arange(-4.0, 4.5, 0.5)
    disk = (np.hypot(*np.meshgrid(side, side)) < radius_px).astype(np.float32)
    disk = cv2.resize(disk, (9, 9), interpolation=cv2.INTER_AREA)
    image = levels(cv2.filter2D(drawn.image.astype(np.float32), -1, disk / disk.sum()))
    finder = TargetFinder([target], response="linear")
    assert finder.find(image)
    assert finder.response_check.lines() == []


@pytest.mark.parametrize("response", ["srgb", "linear"])
def test_nothing_is_said_of_a_response_that_is_stated_rightly(response):
    finder = TargetFinder([make_planar_target("checkerboard")], response=response)
    assert finder.find(image_of("checkerboard", response))
    assert finder.response_check.lines() == []


def test_few_edges_tell_nothing():
    check = LinearResponseCheck()
    finder = TargetFinder([make_planar_target("tag")])
    image = image_of("tag", "srgb")
    check.add(image, finder.find(image), "linear")
    assert check.lines() == []

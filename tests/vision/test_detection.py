"""Detected points against the projection of the target."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from vergence.vision import (
    AprilTag,
    Checkerboard,
    Detection,
    TargetRenderer,
    make_detector,
    make_planar_target,
    parse_target,
)

TARGETS = ("tag", "checkerboard")


def moved(detection: Detection, by_px) -> Detection:
    """A detection predicted elsewhere."""
    return detection._replace(
        point_px=detection.point_px + by_px, corners_px=detection.corners_px + by_px
    )


poses = st.builds(
    pose, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.7, 1.8),
    st.tuples(*[st.floats(-0.3, 0.3)] * 3),
)  # fmt: skip
use_fixtures = settings(
    max_examples=8, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("eye", ["pinhole", "lens"])
@use_fixtures
@given(T_C_T=poses)
def test_point_is_the_projection_of_the_targets_origin(eye, name, rendering, request, T_C_T):
    """Within 0.08 px, four times the rms bias of the smallest tag among these poses.

    Corners are held to the same: a tag's, L-shaped, lie where the lines of its edge meet, which
    blur does not pull inwards.
    """
    camera, target = request.getfixturevalue(eye), make_planar_target(name)
    drawing = TargetRenderer(camera, target, rendering)
    drawing.draw(T_C_T)
    detection = make_detector(target, camera).detect(drawing.frame)
    assert detection.point_px == pytest.approx(camera.project(T_C_T[None, :3, 3])[0], abs=0.08)
    corners = np.column_stack([target.corners_m, np.zeros(len(target.corners_m))])
    corners_C = corners @ T_C_T[:3, :3].T + T_C_T[:3, 3]
    bias_px = {"tag": 0.08, "checkerboard": 0.25}[name]
    assert detection.corners_px == pytest.approx(camera.project(corners_C), abs=bias_px)


@pytest.mark.parametrize("name", TARGETS)
def test_no_bias_over_sub_pixel_shifts(name, pinhole, rendering):
    """The mean over a pixel's phases is 0.01 px: half a pixel of convention would show."""
    target = make_planar_target(name)
    drawing, detector = TargetRenderer(pinhole, target, rendering), make_detector(target)
    errors = []
    for phase in np.arange(0, 1, 0.125):
        wanted = np.array([505.0 + phase, 415.0 + phase])
        x, y = (wanted - pinhole.principal) / pinhole.focal
        drawing.draw(pose(x, y, 1.0))
        detection = detector.detect(drawing.frame)
        errors.append(detection.point_px - wanted)
    assert np.mean(errors, axis=0) == pytest.approx([0, 0], abs=0.01)
    assert np.abs(errors).max() < 0.04


def test_the_response_is_the_stated_one_the_cameras_or_that_of_the_images_kind(pinhole, rendering):
    target = make_planar_target("tag")
    drawing = TargetRenderer(pinhole, target, rendering)
    drawing.draw(pose(0.0, 0.0, 1.0))
    for of_camera, stated, colour, same_as in [
        (None, None, False, "linear"), (None, None, True, "srgb"), (2.2, None, True, 2.2),
        (2.2, "linear", True, "linear"),
    ]:  # fmt: skip
        image = np.repeat(drawing.frame[:, :, None], 3, axis=2) if colour else drawing.frame
        detector = make_detector(target, replace(pinhole, response=of_camera), stated)
        expected = make_detector(target, pinhole, same_as).detect(drawing.frame)
        with named(of_camera, stated, colour):
            for each in (detector, pickle.loads(pickle.dumps(detector))):
                np.testing.assert_array_equal(each.detect(image).corners_px, expected.corners_px)


def test_threads_may_share_a_detector(pinhole, rendering):
    """One with grey images, whose levels are light, and one with colour images, whose are not."""
    target = make_planar_target("tag")
    drawing = TargetRenderer(pinhole, target, rendering)
    drawing.draw(pose(0.02, 0.01, 1.0, (0.3, 0.2, 0.1)))
    images = [drawing.frame, np.repeat(drawing.frame[:, :, None], 3, axis=2)]
    detector = make_detector(target, pinhole)
    alone = [detector.detect(image).corners_px for image in images]
    assert (alone[0] != alone[1]).any()
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(detector.detect, 30 * images))
    for index, found in enumerate(together):
        assert (found.corners_px == alone[index % 2]).all()


def test_every_detector_reads_images_by_the_stated_response():
    for target in (
        "tag:36h11", "checkerboard:9x6", "charuco:7x5:40:30:4X4_50", "aprilgrid:6x6:30:0.3",
    ):  # fmt: skip
        with named(target):
            detector = make_detector(parse_target(target), None, "sRGB")
            assert detector.response_of(np.zeros((9, 9), np.uint8)) == "srgb"


@pytest.mark.slow
def test_tracked_equals_full_frame(pinhole, rendering):
    """Both refinements end at one place, whether the prediction was near or far."""
    for name, miss_px in some_of(TARGETS, [(0, 0), (1.5, -2), (9, 7)]):
        with named(name, miss_px):
            target = make_planar_target(name)
            drawing, detector = TargetRenderer(pinhole, target, rendering), make_detector(target)
            drawing.draw(pose(0, 0, 1.0), np.random.default_rng(0))
            before = detector.detect(drawing.frame)
            assert before is not None
            drawing.draw(pose(0.05, -0.02, 1.02, (0, 0.05, 0)), np.random.default_rng(1))
            full = detector.detect(drawing.frame)
            shift = full.point_px + miss_px - before.point_px
            tracked = detector.track(drawing.frame, moved(before, shift))
            assert tracked is not None
            # fewer pixels take part where a tag is tracked
            assert tracked.point_px == pytest.approx(full.point_px, abs=0.03)
            assert tracked.corners_px == pytest.approx(full.corners_px, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "side"), list(zip(TARGETS * 2, [(-1, 0), (1, 0), (0, -1), (0, 1)], strict=True))
)
def test_target_partly_outside_is_none(name, side, pinhole, rendering):
    target = make_planar_target(name)
    drawing, detector = TargetRenderer(pinhole, target, rendering), make_detector(target)
    drawing.draw(pose(0, 0, 1.0))
    before = detector.detect(drawing.frame)
    assert before is not None
    # The frame's edge cuts through the middle of the board.
    middle = (np.array(target.cells.shape[::-1]) / 2 - target.origin_cells) * target.cell_m
    edge = np.array(side) * (pinhole.width / 2, pinhole.height / 2) / pinhole.focal
    drawing.draw(pose(*(edge - middle), 1.0))
    assert detector.detect(drawing.frame) is None
    predicted = pinhole.project([[*(edge - middle), 1.0]])[0]
    assert detector.track(drawing.frame, moved(before, predicted - before.point_px)) is None


@pytest.mark.parametrize(
    ("name", "angle"), [("tag", 0.7), ("checkerboard", 0.0), ("checkerboard", np.pi / 2)]
)
def test_motion_blinds_before_it_misleads(name, angle, pinhole, rendering):
    """Up to 5 px of smear are seen, and what is seen of longer ones is right."""
    target = make_planar_target(name)
    drawing, detector = TargetRenderer(pinhole, target, rendering), make_detector(target)
    T_C_T = pose(0.0, 0.0, 1.0, (0.1, -0.2, 0.1))
    drawing.draw(T_C_T)
    before = detector.detect(drawing.frame)
    assert before is not None
    for length in np.arange(1.0, 16.0, 2.0):
        smear = length * np.array([np.cos(angle), np.sin(angle)])
        drawing.draw(T_C_T, np.random.default_rng(4), smear)
        seen = detector.track(drawing.frame, before)
        if length <= 5:
            assert seen is not None
        if seen is not None:
            away = np.abs(seen.point_px - before.point_px).max()
            assert away < max(0.25, 3.0 * seen.sigma_px.max())


@pytest.mark.slow
def test_noise_lies_in_the_articles_range_on_the_simulated_rig(pinhole, rendering):
    """0.006 to 0.057 px, or a little less of a tag, whose cells count; known to 9 %."""
    for target in (AprilTag(), Checkerboard()):
        drawing, detector = TargetRenderer(pinhole, target, rendering), make_detector(target)
        rng = np.random.default_rng(8)
        T_C_T = pose(0.01, 0.02, 1.5)
        drawing.draw(T_C_T, rng)
        first = detector.detect(drawing.frame)
        assert first is not None
        points = []
        for _ in range(60):
            drawing.draw(T_C_T, rng)
            seen = detector.track(drawing.frame, first)
            points.append(seen.point_px)
        deviation = np.std(points, axis=0, ddof=1)
        assert (deviation > 0.004).all()
        assert (deviation < 0.057).all()

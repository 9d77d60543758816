"""The presets of heads that others built: numbers of their sources, and nothing but numbers."""

import numpy as np

from tests.models.urdf.descriptions import UrdfKinematics, real_robot
from tests.naming import named
from vergence.models import load_head
from vergence.models.head_file import head_to_toml, parse_head


def test_what_nobody_measured_is_marked():
    for head in map(load_head, ("icub", "turrets")):
        with named(head.name):
            assert any("acceleration" in key for key in head.assumptions)
            assert {"timing.latency_s", "timing.lag_s"} <= set(head.assumptions)
            assert parse_head(head_to_toml(head)) == head


def test_the_icub_moves_as_its_urdf():
    kinematics = UrdfKinematics(real_robot("icub_visuomanip.urdf").read_text(encoding="utf-8"))
    head = load_head("icub")
    rng = np.random.default_rng(0)
    for q in rng.uniform(head.limits.lower, head.limits.upper, (200, 7)):
        q[5] = q[3]
        angles = dict(zip(head.joints, q, strict=True))
        cameras = head.base_pose(q) @ head.camera_poses(q)
        for camera, frame in zip(cameras, ("l_eye", "r_eye"), strict=True):
            expected = kinematics.pose(frame, "chest", angles)
            np.testing.assert_allclose(camera, expected, atol=1e-9)


def test_the_icub_has_a_common_tilt_version_and_vergence():
    head = load_head("icub")
    assert head.actuation.names == ("eyes_tilt", "eyes_version", "eyes_vergence")
    origins = head.camera_poses(np.zeros(7))[:, :3, 3]
    np.testing.assert_allclose(origins, [[-0.034, 0, 0], [0.034, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(head.limits.upper[[4, 6]]), [55.0, 30.0])
    # both eyes turn inwards under a positive vergence
    q = head.actuation.joints_of([0, 0, 0, 0, 0, 0.2, 0])
    axes = head.camera_poses(q)[:, :3, 2]
    assert axes[0, 0] > 0.05
    assert axes[1, 0] < -0.05


def test_the_turrets_pan_before_they_tilt():
    head = load_head("turrets")
    assert head.actuation.direct
    assert head.joints[3:] == ("left_pan", "left_tilt", "right_pan", "right_tilt")
    origins = head.camera_poses(np.zeros(7))[:, :3, 3]
    np.testing.assert_allclose(origins, [[-0.075, 0, 0], [0.075, 0, 0]], atol=1e-12)
    # 42.25 mm from pan to tilt, 61.5 mm up and 31.2 mm ahead of it to the camera
    up = head.camera_poses([0, 0, 0, 0, -np.pi / 2, 0, 0])[0, :3, 3]
    np.testing.assert_allclose(up, [-0.075, 0.0615 - 0.0312, -0.0312 - 0.0615], atol=1e-12)
    assert head.timing.frame_rate_hz == 30.0

"""The eye angles that look at a point, and points that are hardly meant so."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.grids import some_of
from tests.naming import named, refused
from vergence.errors import VergenceWarning
from vergence.models import load_head

HEADS = ["simulated", "physical", "icub", "turrets"]
DATA = Path(__file__).resolve().parents[1] / "data"


def test_every_point_of_the_article_is_fixated(simulated, physical):
    for table, count in ((3, 21), (5, 21), (7, 8)):
        (path,) = DATA.glob(f"table{table}_*_points.csv")
        rows = np.genfromtxt(path, delimiter=",", names=True)
        points = np.stack([rows[f"{axis}_mm"] for axis in "xyz"], axis=-1) / 1000.0
        assert len(points) == count
        for head in (simulated, physical):
            with named(table, head.name):
                q = head.fixate(points)
                assert np.abs(head.project(q, points) - head.cameras.principal).max() < 1e-9
                assert head.limits.contains(q).all()


def test_points_at_the_edge_of_the_limits_are_fixated_with_any_neck(head, simulated, random_poses):
    q = random_poses(head, 500)
    poses = head.camera_poses(q)
    for eye, joints in ((0, slice(3, 5)), (1, slice(5, 7))):
        points = poses[:, eye, :3, 3] + 1.5 * poses[:, eye, :3, 2]
        found = head.fixate(points, neck=q[:, :3])
        np.testing.assert_allclose(found[:, joints], q[:, joints], atol=1e-9)
        np.testing.assert_array_equal(found[:, :3], q[:, :3])
    # the neck takes part in no way but its own angles
    point = np.array([0.1, -0.1, 1.0])
    np.testing.assert_array_equal(simulated.fixate(point)[:3], 0.0)
    turned = simulated.fixate(point, neck=[0.1, 0.2, 0.3])
    np.testing.assert_array_equal(turned[:3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(turned[3:], simulated.fixate(point)[3:])


def test_a_point_that_no_eye_can_look_at_has_no_angles_and_spares_the_others(simulated):
    # both eyes turn about one line, 30.33 mm below them: what lies nearer to it than the eyes
    # is below them however they tilt
    on_axis = simulated.camera_poses(np.zeros(7))[:, :3, 3].mean(axis=0) + [0.0, 0.03033, 0.0]
    q = simulated.fixate(on_axis + np.outer([0.0, 0.02, 0.05], [0.0, 0.0, 1.0]))
    assert np.isnan(q[:2, 3:]).all()
    assert np.isfinite(q[2]).all()
    q = simulated.fixate([[0.0, 0.0, 0.0138], [0.0, 0.0, np.nan], [0.0, 0.0, np.inf], [0, 0, 1.0]])
    assert np.isnan(q[:3, 3:]).all()
    assert np.isfinite(q[3]).all()
    assert np.isnan(simulated.fixate([0.0, 0.0, np.nan])[3:]).all()


def test_a_point_in_millimetres_is_asked_about_and_answered():
    for name in HEADS:
        with named(name):
            head, point = load_head(name), [100.0, -100.0, 800.0]
            asked = r"points.*\(100, -100, 800\).*in millimetres\?"
            with pytest.warns(VergenceWarning, match=asked) as said:
                q = head.fixate(point)
            assert len(said) == 1
            assert said[0].filename == __file__, "the line of the caller"
            np.testing.assert_array_equal(q, head.fixate([point])[0])


def test_what_is_no_point_or_neck_is_refused_by_the_name_of_the_call(head):
    refused(r"^fixate: points: expected shape \(..., 3\), got \(2,\)", head.fixate, [0.0, 1.0])
    refused(r"^fixate: neck: expected shape", head.fixate, [0.0, 0.0, 1.0], neck=[0.0, 1.0])


def test_angles_beyond_the_limits_are_said_by_name():
    points = [(0.1, 0.0, -1.0), (0.0, -2.0, 0.5), (0.0, 2.0, 0.5)]
    for name, point in some_of(["simulated", "icub"], points):
        with named(name, point):
            head = load_head(name)
            q = head.fixate([point])[0]
            assert not head.reaches(q)
            own = "|".join(head.actuation.names)
            with pytest.warns(VergenceWarning, match=rf"({own}) would be at .* degrees, outside"):
                head.fixate(point)


def test_what_a_head_looks_at_or_a_program_judges_is_not_asked_about(simulated):
    for name, distance in some_of(HEADS, [0.5, 20.0, 1e6, np.inf]):
        with named(name, distance), warnings.catch_warnings():
            warnings.simplefilter("error")
            load_head(name).fixate([0.0, 0.0, distance])
    head = load_head("turrets")
    assert head.reaches(head.fixate([0.1, 0.0, -1.0]))
    # 0.15 m between the eyes times 6000 px by 800 m is a disparity of 1.1 px
    head = head.replace(cameras={"focal": np.full((2, 2), 6000.0)})
    assert head.reaches(head.fixate([0.0, 0.0, 800.0]))
    # programs that judge the angles themselves
    simulated.fixate([0.1, 0.0, -1.0], warn=False)
    for head in (simulated, load_head("icub")):
        head.least_error([0.1, 0.0, -1.0])
    assert np.isfinite(simulated.fixate([[100.0, -100.0, 800.0], [0.1, 0.0, -1.0]])).all()

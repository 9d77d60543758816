"""Identity of an object between both eyes, and from image to image."""

import numpy as np
import pytest

from vergence.models.head_file import load_head
from vergence.vision import Camera, Detection
from vergence.vision.objects.identity import Identity

HEAD = load_head("physical")
FRAME_S = 1.0 / 30.0
ONE, OTHER = np.array([0.0, -0.1, 1.0]), np.array([0.25, -0.1, 1.1])


class Scene:
    """A head at rest, and objects before it."""

    def __init__(self):
        self.cameras = [Camera.of(HEAD, eye) for eye in range(2)]
        q = HEAD.rest()
        self.poses = HEAD.base_pose(q) @ HEAD.camera_poses(q)
        self.identity, self.frames = Identity(self.cameras), 0

    def detections(self, eye, points, sizes=None):
        pixels = HEAD.project(HEAD.rest(), np.array(points).reshape(-1, 3))[:, eye]
        sizes = sizes or [40.0] * len(points)
        return [
            Detection(p, 0.5 * np.ones(2), size_px=s) for p, s in zip(pixels, sizes, strict=True)
        ]

    def see(self, left, right=None, sizes=None):
        """Show objects at points of N to both eyes; index of the chosen one by eye, or None."""
        self.frames += 1
        time_s = FRAME_S * self.frames
        shown = [
            self.detections(0, left, sizes),
            self.detections(1, left if right is None else right, sizes),
        ]
        for eye in range(2):
            self.identity.post(eye, shown[eye], self.poses[eye], time_s)
        found = [self.identity.choose(eye) for eye in range(2)]
        return [
            None if one is None else next(i for i, each in enumerate(own) if each is one)
            for one, own in zip(found, shown, strict=True)
        ]


def test_both_eyes_choose_the_same_object():
    scene = Scene()
    left, right = scene.see([ONE, OTHER])
    assert left is not None
    assert left == right


def test_eyes_that_see_different_things_choose_none():
    scene = Scene()
    assert scene.see([ONE], [ONE + [0.0, 0.15, 0.0]]) == [None, None]
    far_apart_in_size = Scene()
    for eye, size in enumerate((40.0, 90.0)):
        one = far_apart_in_size.detections(eye, [ONE], [size])
        far_apart_in_size.identity.post(eye, one, far_apart_in_size.poses[eye], 1.0)
    assert far_apart_in_size.identity.choose(0) is None


def test_one_eye_alone_is_enough_if_the_other_sees_nothing():
    scene = Scene()
    assert scene.see([ONE], []) == [0, None]


def test_the_target_stays_the_target_while_another_object_comes_nearer():
    scene = Scene()
    scene.see([ONE])
    for share in np.linspace(0.0, 1.0, 20):
        passing = OTHER + share * (ONE + [0.06, 0.0, 0.0] - OTHER)
        assert scene.see([passing, ONE]) == [1, 1]


def test_a_jump_to_another_object_is_refused_for_half_a_second_and_counted_once():
    scene = Scene()
    for _ in range(5):
        assert scene.see([ONE, OTHER], sizes=[60.0, 40.0]) == scene.see(
            [ONE, OTHER], sizes=[60.0, 40.0]
        )
    chosen = scene.see([ONE, OTHER])[0]
    left = [ONE, OTHER][1 - chosen]
    refused = [scene.see([left]) for _ in range(int(0.5 / FRAME_S) - 1)]
    assert refused == [[None, None]] * len(refused)
    assert scene.identity.refused in (1, 2)  # by each eye once
    accepted = [scene.see([left]) for _ in range(4)]
    assert accepted[-1] == [0, 0]


def test_a_single_target_that_has_moved_quickly_is_followed_at_once():
    scene = Scene()
    for _ in range(5):
        scene.see([ONE])
    assert scene.see([OTHER]) == [0, 0]


def test_names_are_kept_from_image_to_image():
    scene = Scene()
    for time_s, order in ((0.1, ("a", "b")), (0.2, ("b", "a"))):
        for eye in range(2):
            shown = [
                one._replace(id=name)
                for one, name in zip(
                    scene.detections(eye, [ONE, ONE + [0.03, 0.0, 0.0]]), order, strict=True
                )
            ]
            scene.identity.post(eye, shown, scene.poses[eye], time_s)
        names = [scene.identity.choose(eye).id for eye in range(2)]
        assert names == ["a", "a"]


@pytest.mark.parametrize("speed_rad_s", [0.5, 1.0])
def test_the_hint_leads_a_moving_target(speed_rad_s):
    scene = Scene()
    for k in range(6):
        scene.see([[np.sin(speed_rad_s * FRAME_S * k), 0.0, np.cos(speed_rad_s * FRAME_S * k)]])
    angle = speed_rad_s * FRAME_S * 6
    expected = HEAD.project(HEAD.rest(), [np.sin(angle), 0.0, np.cos(angle)])
    for eye in range(2):
        hint = scene.identity.hint(eye, scene.poses[eye], FRAME_S * 7)
        assert np.linalg.norm(hint - expected[eye]) < 3.0

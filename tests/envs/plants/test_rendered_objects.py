"""Objects in a room, seen by the rendered plant."""

import cv2
import numpy as np
import pytest

from tests.naming import refused
from vergence.controllers import make_controller
from vergence.envs.plants import rendered
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.envs.targets import separate_look
from vergence.envs.task import GazeTask
from vergence.models.head_file import load_head
from vergence.vision.detection import Detection
from vergence.vision.objects import faces
from vergence.vision.objects.targets import FaceTarget

HEAD = load_head("turrets")
POINT = [0.05, -0.05, 0.9]


def gaze(target, steps=150, **options):
    """Run a gaze with state-feedback; the task at its end, closed."""
    task = GazeTask(1, head=HEAD, plant="rendered", target=target, plant_options=options)
    controller = make_controller("state-feedback", head=HEAD)
    task.begin(np.zeros(1, int), np.zeros(1, np.uint64), np.zeros(1, np.uint64))
    state = None
    for step in range(steps):
        action, state = controller.predict(
            task.observation.copy(), state=state, episode_start=np.array([step == 0])
        )
        task.step(task.as_action(action))
    task.close()
    return task


@pytest.mark.slow
@pytest.mark.parametrize("look", ["colour:#ff8000", "point", "place:50:-50:900"])
def test_both_eyes_come_to_look_at_it(look):
    task = gaze({"kind": "static", "point": POINT, "look": look})
    assert task.reading.visible.all()
    assert np.linalg.norm(task.truth().pixel_error[0], axis=-1).max() < 1.0


@pytest.mark.slow
def test_a_clicked_point_of_the_wall_is_looked_at():
    target = {"kind": "static", "point": POINT, "look": "point"}
    task = GazeTask(1, head=HEAD, plant="rendered", target=target, plant_options={"scene": "room"})
    task.begin(np.zeros(1, int), np.zeros(1, np.uint64), np.zeros(1, np.uint64))
    seen = task.plant.click(1, [200.0, 180.0])
    assert np.allclose(HEAD.project(HEAD.rest(), seen)[1], [200.0, 180.0], atol=1e-6)
    for _ in range(20):  # the latency and some more
        task.step(np.zeros((1, 4)))
    assert task.reading.visible.all()
    assert np.abs(task.reading.pixels[0] - HEAD.project(HEAD.rest(), seen)).max() < 0.5
    task.close()


class Green:
    """A network that takes the green spot of an image for a face."""

    def __init__(self, target, camera):
        self.size = camera.size

    def detect(self, image):
        assert image.shape[1::-1] == self.size
        v, u = np.argwhere(image[..., 1] > 200).mean(axis=0)
        return [Detection(np.array([u, v]), 1.0)] if image[0, 0, 2] else []


@pytest.mark.slow
def test_the_face_of_a_photograph_stands_at_the_targets_place(tmp_path, monkeypatch):
    monkeypatch.setattr(faces, "FaceDetector", Green)
    picture = np.full((1000, 800, 3), 60, np.uint8)
    cv2.circle(picture, (250, 700), 40, (0, 255, 0), -1)
    cv2.imwrite(str(tmp_path / "anna.png"), picture)
    shown = rendered.scene_of(FaceTarget(model="net"), f"poster:{tmp_path}/anna.png:300", None)
    views = RoomImageRenderer(HEAD, shown)
    images = views.draw(HEAD.rest(), np.zeros(7), POINT)
    for image, expected in zip(images, HEAD.project(HEAD.rest(), POINT), strict=True):
        v, u = np.argwhere(image[..., 1] > 100.0 + image[..., 0]).mean(axis=0)
        assert np.abs([u, v] - expected).max() < 0.5
    cv2.imwrite(str(tmp_path / "dark.png"), picture * np.uint8([1, 1, 0]))
    dark = f"poster:{tmp_path}/dark.png"
    refused(
        "in which face:net finds a face", rendered.scene_of, FaceTarget(model="net"), dark, None
    )


def test_what_moves_and_what_it_is_are_told_apart():
    assert separate_look("colour:#ff8000") == ("random", "colour:#ff8000")
    assert separate_look("point") == ("random", "point")
    assert separate_look("circle") == ("circle", None)
    assert separate_look({"kind": "circle", "look": "point"}) == ({"kind": "circle"}, "point")
    assert separate_look({"look": "mine.py:Ball"}) == ("random", "mine.py:Ball")


def test_what_cannot_be_shown_is_refused():
    def task(target="colour:#ff8000", plant="rendered", **options):
        GazeTask(1, head=HEAD, plant=plant, target=target, plant_options=options)

    refused("target: expected the plant rendered", task, plant="kinematic")
    refused("scene: expected ball", task, scene="cube")
    refused("scene: expected a target in a room", task, target="random", scene="ball")
    refused("look: expected a tag", task, target="charuco:7x5:40:30:4X4_50")
    refused("wall: ", task, wall="gone.png")

"""Search of both eyes' images: users' detectors, slow ones, and places without images."""

import time

import cv2
import numpy as np
import pytest

from vergence.errors import ConfigurationError
from vergence.models.head_file import load_head
from vergence.vision.objects import search
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.targets import parse_gaze_target

HEAD = load_head("physical")
POSES = HEAD.base_pose(HEAD.rest()) @ HEAD.camera_poses(HEAD.rest())
PLACE = np.array([0.02, -0.05, 0.9])
PIXELS = HEAD.project(HEAD.rest(), PLACE)
BLANK = np.full((2, 2), -50.0)
OWN = '''
import os
import pathlib
import time
from vergence.vision import Detection

class Spot:
    """The brightest pixel."""
    def detect(self, image, hint):
        v, u = divmod(int(image[..., 2].argmax()), image.shape[1])
        return [Detection((u, v), 0.5)]

class Late(Spot):
    latency_s, rate_hz = 0.1, 10.0

class Old(Spot):
    latency_s, rate_hz = 2.0, 0.5

class Ends(Spot):
    def detect(self, image, hint):
        os._exit(3)

class Both(Spot):
    both_eyes = True
    def detect(self, images, hints):
        return [Spot.detect(self, image, None) for image in images]

class Blocked(Both):
    def detect(self, images, hints):
        print("not an answer")
        begun = time.monotonic()
        while time.monotonic() < begun + 10.0:  # holds the interpreter
            if pathlib.Path(__file__).with_name("go").exists():
                return super().detect(images, hints)

class Broken:
    def detect(self, image, hint):
        return 1 / 0
'''


def images(places=PIXELS, textured=False):
    """Both eyes' images with a spot at a pixel of each."""
    out = []
    for eye, (width, height) in enumerate(HEAD.cameras.size.tolist()):
        image = np.full((height, width, 3), 60, np.uint8)
        if textured:
            noise = np.random.default_rng(eye).integers(
                20, 180, (height // 4, width // 4), np.uint8
            )
            image[:] = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)[..., None]
            image = np.minimum(image, 200)
        cv2.circle(image, tuple(np.round(places[eye]).astype(int).tolist()), 3, (255, 255, 255), -1)
        out.append(image)
    return out


@pytest.fixture
def search_of(tmp_path):
    made = []

    def make(name, frame_s=None):
        (tmp_path / "own.py").write_text(OWN)
        target = parse_gaze_target(f"{tmp_path / 'own.py'}:{name}")
        made.append(HeadSearch(target, HEAD, frame_s))
        return made[-1]

    yield make
    for one in made:
        one.shared.close()


def look(search, time_s, shown):
    """Show both eyes' images; what each eye says."""
    for eye, one in enumerate(search.eyes):
        one.look(shown[eye], POSES[eye], time_s)
    return [one.found() for one in search.eyes]


@pytest.mark.parametrize("name", ["Spot", "Both"])
def test_a_detector_of_ones_own_finds_its_target_in_both_eyes(search_of, name):
    search = search_of(name)
    for time_s in (0.0, 0.03):
        found = look(search, time_s, images())
    for eye in range(2):
        assert np.abs(found[eye].detection.pixel - PIXELS[eye]).max() < 4.0


def test_grey_images_are_given_in_three_channels(search_of):
    search = search_of("Spot")
    found = look(search, 0.0, [image[..., 0] for image in images()])
    assert found[1].detection is not None


def test_an_error_in_it_names_its_file_and_line(search_of):
    with pytest.raises(ConfigurationError, match=r"own.py:38 in detect: ZeroDivisionError"):
        look(search_of("Broken"), 0.0, images())


def test_an_answer_that_cannot_be_carried_is_where_the_target_was(search_of):
    search = search_of("Late")
    gone = images(BLANK)
    answers = [look(search, k / 30.0, gone if k else images()) for k in range(6)]
    assert answers[:3] == [[None, None]] * 3
    for k in range(3, 6):
        for eye, one in enumerate(answers[k]):
            assert np.abs(one.detection.pixel - PIXELS[eye]).max() < 4.0


@pytest.mark.parametrize(("rate_hz", "tracked"), [(30.0, True), (120.0, False)])
def test_a_target_at_rest_stays_while_eyes_turn_and_its_detector_takes_2_s(
    search_of, rate_hz, tracked
):
    search, shown, q = search_of("Old"), images(), HEAD.rest()
    errors_px, kept = [], 0
    for k in range(round(4.5 * rate_hz)):
        if k > 2.1 * rate_hz:  # after the first answer, and through the second one
            q = HEAD.rest() + np.repeat([0.0, 0.05], [3, 4]) * np.sin(0.2 * k)
            shown = images(HEAD.project(q, PLACE) if tracked else BLANK)
        poses = HEAD.base_pose(q) @ HEAD.camera_poses(q)
        for eye, one in enumerate(search.eyes):
            one.look(shown[eye], poses[eye], k / rate_hz)
            found = one.found()
            if k >= 2.0 * rate_hz + 1:
                errors_px.append(found.detection.pixel - HEAD.project(q, PLACE)[eye])
            kept = max(kept, len(one._recent))
    assert np.abs(errors_px).max() < 4.0
    assert kept <= 33


def test_an_answer_is_carried_to_later_images_by_tracking(search_of):
    search = search_of("Late")
    for k in range(8):
        moved = PIXELS + [2.0 * k, -k]
        shown = [np.roll(one, (-k, 2 * k), (0, 1)) for one in images(textured=True)]
        found = look(search, k / 30.0, shown)
        if k < 3:
            assert found == [None, None]
            continue
        for eye, one in enumerate(found):
            assert np.abs(one.detection.pixel - moved[eye]).max() < 4.0


def test_a_slow_detector_holds_up_no_image(search_of, tmp_path):
    search = search_of("Blocked", frame_s=0.02)
    begun = time.monotonic()
    held = [look(search, 0.02 * k, images(BLANK if k else PIXELS)) for k in range(10)]
    assert time.monotonic() - begun < 8.0  # of 10 s
    assert held == [[None, None]] * 10
    (tmp_path / "go").touch()
    first: list = [None, None]
    for k in range(10, 2000):
        time.sleep(0.005)
        found = look(search, 0.02 * k, images(BLANK))
        first = [one or other for one, other in zip(first, found, strict=True)]
        if None not in first:
            break
    for eye, one in enumerate(first):  # where it was in the first image
        assert np.abs(one.detection.pixel - PIXELS[eye]).max() < 4.0


def test_a_detector_is_asked_for_one_image_at_a_time_though_it_is_forgotten(search_of):
    naps, at_work, most = search_of("Spot", frame_s=0.02), [], []

    def detect(*_arguments):
        at_work.append(0)
        most.append(len(at_work))
        time.sleep(0.12)
        at_work.pop()

    naps.shared._detect = detect
    for k in range(8):
        naps.forget()
        naps.eyes[0].look(images()[0], POSES[0], 0.02 * k)
        time.sleep(0.03)
    assert set(most) == {1}


def test_a_detector_that_hangs_is_told_and_ended(search_of, monkeypatch):
    monkeypatch.setattr(search, "_ANSWER_S", 0.3)
    hangs, begun = search_of("Blocked", frame_s=0.02), time.monotonic()

    def look_on():
        for k in range(200):
            look(hangs, 0.02 * k, images())
            time.sleep(0.02)

    with pytest.raises(ConfigurationError, match=r"to answer within 0\.3 s, got nothing"):
        look_on()
    hangs.shared.close()
    assert time.monotonic() - begun < 6.0  # of 10 s


@pytest.mark.parametrize("size_px", [30.0, 60.0, 120.0])
def test_the_size_of_what_states_none_is_seen(size_px):
    image = images(BLANK, textured=True)[0]
    cv2.circle(image, (320, 240), round(size_px / 2), (40, 90, 220), -1)
    found, mix = search._contrast(image, np.array([320.0, 240.0]), search._SIZES_PX)
    assert 0.8 < found / size_px < 1.25
    assert mix.shape == (1, 4)


@pytest.mark.parametrize(
    ("name", "expected"), [("Broken", "ZeroDivisionError"), ("Ends", "it has ended")]
)
def test_what_ends_a_detector_of_a_robot_is_told_with_the_next_image(search_of, name, expected):
    search = search_of(name, frame_s=0.02)

    def look_on():
        for k in range(100):
            look(search, 0.02 * k, images())
            time.sleep(0.02)

    with pytest.raises(ConfigurationError, match=expected):
        look_on()


def test_a_place_is_where_the_heads_model_has_it():
    target = parse_gaze_target("place:" + ":".join(str(1000.0 * value) for value in PLACE))
    found = look(HeadSearch(target, HEAD), 0.1, [None, None])
    for eye in range(2):
        assert np.allclose(found[eye].detection.pixel, PIXELS[eye], atol=1e-6)


def test_a_place_out_of_view_stands_at_the_edge_on_its_side():
    found = look(HeadSearch(parse_gaze_target("place:2000:0:-100"), HEAD), 0.1, [None, None])
    for eye, one in enumerate(found):
        u, v = one.detection.pixel
        assert 0.75 * HEAD.cameras.size[eye, 0] < u < HEAD.cameras.size[eye, 0]
        assert 0 < v < HEAD.cameras.size[eye, 1]

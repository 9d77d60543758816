"""Images as detectors take them: every kind a camera or a file gives, and what is none."""

import io
import re
import struct

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.grids import some_of
from tests.naming import named, refused
from tests.vision.scenes import rig
from vergence.errors import UnreadableFileError
from vergence.models.camera import light_table
from vergence.vision import AprilTag, Checkerboard, as_grey, make_detector, read_image
from vergence.vision.image import grey_if_channels_equal, has_orientation_tag, open_video

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
"""0 to 235 in steps of 5."""
LARGE = cv2.resize(GREY, (160, 120), interpolation=cv2.INTER_CUBIC)
ALL_LEVELS = np.arange(256).reshape(16, 16)


def wide(bits: int, dtype: object = np.uint16) -> np.ndarray:
    """Levels of so many bits that are all of 8 bits."""
    return np.rint(ALL_LEVELS * ((2**bits - 1) / 255)).astype(dtype)


def with_pixel(image: np.ndarray, value: float) -> np.ndarray:
    out = image.copy()
    out[2, 3] = value
    return out


LEVELS = {
    "a list": (GREY.tolist(), GREY),
    "one channel": (GREY[:, :, None], GREY),
    **{
        f"{bits} bits of {dtype}": (wide(bits, dtype), ALL_LEVELS)
        for bits, dtype in some_of([10, 12, 14, 16], ["u2", ">u2", "i4", "u4", "i8"])
    },
    **{f"8 bits in {dtype}": (GREY.astype(dtype), GREY) for dtype in ("u2", "i2", "i8", "f4")},
    **{f"shares of white in {dtype}": ((GREY / 255).astype(dtype), GREY) for dtype in ("f4", "f8")},
    "floats of a wide camera": (GREY * (4095.0 / 235.0), np.rint(GREY * (255.0 / 235.0))),
    "bool": (GREY > 100, np.where(GREY > 100, 255, 0)),
    "below 0": (np.array([[-3.0, 0.0, 255.0, 51.0]]), [[0, 0, 255, 51]]),
    "huge": (np.array([[0.0, 1e300]]), [[0, 255]]),
    "nan alone": (np.full((4, 5), np.nan), np.zeros((4, 5))),
    **{
        f"one {bad}": (with_pixel(GREY.astype(float), bad), with_pixel(GREY, level))
        for bad, level in ((np.nan, 0), (np.inf, 255), (-np.inf, 0))
    },
}
"""Images of grey, and their levels of 8 bits."""


@pytest.mark.parametrize("kind", LEVELS)
def test_any_numbers_become_levels_of_8_bits_and_stay_what_they_were(kind):
    given, expected = LEVELS[kind]
    if isinstance(given, np.ndarray):
        given.setflags(write=False)
    grey = as_grey(given)
    assert grey.dtype == np.uint8
    assert grey.flags.writeable
    np.testing.assert_array_equal(grey, expected)


def test_levels_of_8_bits_are_taken_as_they_are_and_views_in_one_piece_of_memory():
    assert as_grey(GREY) is GREY
    views = [np.s_[::-1], np.s_[:, ::-1], np.s_[::2, ::3], np.s_[1:, 2:5]]
    for view, dtype in some_of(views, [np.uint8, np.uint16, np.float64]):
        with named(view, dtype):
            grey = as_grey(GREY.astype(dtype)[view])
            assert grey.flags.c_contiguous
            np.testing.assert_array_equal(grey, GREY[view])


def test_colours_are_weighted_as_opencv_does():
    """The order is OpenCV's, blue first; alpha has no part in it."""
    for channels, full in some_of([3, 4], [255, 1023, 65535, 1.0]):
        with named(channels, full):
            colours = np.zeros((4, 5, channels))
            for row in range(3):
                colours[row, :, row] = full
            colours[3, :, :3] = full
            colours[..., 3:] = 0.3 * full
            image = colours.astype({255: np.uint8, 1.0: np.float32}.get(full, np.uint16))
            image.setflags(write=False)
            grey = as_grey(image)
            assert grey.shape == (4, 5)
            # ITU-R BT.601, rounded in each channel and in the sum
            assert grey[:, 0] == pytest.approx([0.114 * 255, 0.587 * 255, 0.299 * 255, 255], abs=1)


def test_a_response_gives_light_and_colours_are_weighted_as_light():
    """Full blue and red with half of the light in green; their levels weigh 0.853 of white."""
    np.testing.assert_allclose(as_grey(GREY, response="srgb"), light_table("srgb")[GREY])
    image = np.array([[[255, 188, 255]]], np.uint8)
    light = as_grey(image, response="srgb")[0, 0] / 255.0
    assert light == pytest.approx(0.114 + 0.587 * 0.503 + 0.299, abs=1e-3)
    assert as_grey(image)[0, 0] / 255.0 == pytest.approx(0.846, abs=0.01)
    np.testing.assert_allclose(as_grey(image.astype(np.uint16) * 257, response="srgb") / 255, light)


def test_a_response_is_applied_to_the_depth_that_an_image_has():
    wide = np.array([[0, 100, 200, 65535]], np.uint16)  # all but the last one level of 8 bits
    expected = 255.0 * (wide / 65535.0) ** 2.2
    np.testing.assert_allclose(as_grey(wide, response=2.2), expected, rtol=1e-4)


def test_a_frame_of_a_video_has_colours_only_where_its_camera_has():
    grey = np.tile(GREY, (4, 4))
    frame = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    np.testing.assert_array_equal(grey_if_channels_equal(frame), grey)
    assert grey_if_channels_equal(grey) is grey
    frame[16, 24, 2] ^= 2  # as a codec rounds
    assert grey_if_channels_equal(frame).ndim == 2
    frame[16, 24, 2] ^= 8
    assert grey_if_channels_equal(frame) is frame


class Refusing:
    """Object that cannot become an array, like a tensor on a graphics card."""

    def __array__(self, dtype=None, copy=None):
        raise TypeError("can't convert device tensor to numpy")


def test_what_is_no_image_is_refused_in_one_line():
    for image in [
        None, "photo.png", 3.5, {"image": GREY}, [], [[1, 2], [3]], [GREY, GREY[:3]], [["a", "b"]],
        np.zeros(7), np.zeros((2, 3, 3, 3), np.uint8), np.zeros((5, 5, 2), np.uint8),
        np.zeros((5, 5, 5), np.uint8), np.zeros((5, 5), complex), np.zeros((5, 5), object),
        np.zeros((5, 5), "M8[s]"), np.zeros((0, 5), np.uint8), np.zeros((5, 0, 1), bool),
        np.full((3, 4), -1), np.full((3, 4, 3), -7, np.int16), Refusing(),
    ]:  # fmt: skip
        assert len(str(refused("image: expected .* got", as_grey, image))) < 300
    detector = make_detector(AprilTag(), rig("physical")[0])
    for find in (detector.detect, detector.detect_all, detector.search):
        refused("image: expected .* 640 x 479", find, np.zeros((479, 640), np.uint8))


def test_an_image_of_a_few_pixels_shows_nothing():
    for shape, target in some_of(
        [(1, 1), (1, 640), (640, 1), (2, 2), (7, 9), (23, 24), (25, 25), (17, 2000)],
        [AprilTag(), Checkerboard()],
    ):
        with named(shape, target):
            noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
            detector = make_detector(target)
            for image in (np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8), noise):
                assert detector.detect_all(image) == []


# files


def encoded(image: np.ndarray, ending: str) -> bytes:
    done, data = cv2.imencode(ending, image)
    assert done
    return data.tobytes()


def test_a_file_without_losses_is_read_as_it_is(tmp_path):
    opaque = np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)])
    for ending, image, expected in [
        *((ending, GREY, GREY) for ending in (".png", ".tiff", ".bmp", ".pgm")),
        *((".png", wide(bits), ALL_LEVELS) for bits in (10, 16)),
        (".png", cv2.cvtColor(wide(12), cv2.COLOR_GRAY2BGR), ALL_LEVELS), (".png", opaque, GREY),
    ]:  # fmt: skip
        with named(ending, image):
            path = tmp_path / f"image{ending}"
            path.write_bytes(encoded(image, ending))
            np.testing.assert_array_equal(read_image(path), expected)
            np.testing.assert_array_equal(read_image(str(path)), expected)


def tagged(suffix: str, orientation: int) -> bytes:
    """A file of LARGE that says how the camera was held."""
    content, exif = io.BytesIO(), Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(LARGE).save(content, suffix, exif=exif, lossless=True, quality=100)
    return content.getvalue()


def test_a_photograph_is_measured_as_its_sensor_had_it(tmp_path):
    for suffix in ("jpeg", "png", "webp", "tiff"):
        for orientation in range(1, 9):
            with named(suffix, orientation):
                path = tmp_path / "held with spaces, ümlaut.image"
                path.write_bytes(tagged(suffix, orientation))
                np.testing.assert_allclose(read_image(path), LARGE, atol=3)
                assert has_orientation_tag(path) == (orientation > 1)


def test_a_video_is_measured_as_its_sensor_had_it(tmp_path):
    path = tmp_path / "held.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    content = path.read_bytes()
    start = content.index(b"tkhd") + 44  # of the track's matrix
    upright, turned = (
        struct.pack(">6i", *(value << 16 for value in each))
        for each in ([1, 0, 0, 0, 1, 0], [0, 1, 0, -1, 0, 0])
    )
    assert content[start : start + 24] == upright
    path.write_bytes(content[:start] + turned + content[start + 24 :])
    assert cv2.VideoCapture(str(path)).read()[1].shape[:2] == (64, 48)
    with open_video(str(path)) as images:
        assert next(images).shape[:2] == (48, 64)


DAMAGED = {
    "empty": (b"", "empty"), "text": (b"not an image at all\n" * 40, "no image"),
    "png without its end": (encoded(LARGE, ".png")[:-400], "damaged"),
    "png of its first bytes": (encoded(LARGE, ".png")[:30], "damaged"),
    "jpeg of its first bytes": (encoded(LARGE, ".jpg")[:40], "damaged"),
    "jpeg of half": (encoded(LARGE, ".jpg")[: len(encoded(LARGE, ".jpg")) // 2], "damaged"),
    "tiff of half": (encoded(LARGE, ".tiff")[:400], "damaged"), "zeros": (bytes(1000), "no image"),
}  # fmt: skip


def test_a_file_that_is_no_image_is_refused_in_one_line(tmp_path, capfd):
    path = tmp_path / "image.png"
    for damage, (content, said) in DAMAGED.items():
        path.write_bytes(content)
        with named(damage):
            refused(f"image.png.*{said}", read_image, path, error=UnreadableFileError)
            assert capfd.readouterr().err == ""  # where the C libraries would write
    for none in (tmp_path / "nothing.png", tmp_path, path / "image.png", f"{tmp_path}/a\0b.png"):
        refused(re.escape(str(tmp_path)), read_image, none, error=UnreadableFileError)

"""Images as detectors take them: every kind a camera or a file gives, and what is none."""

import io
import struct

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.grids import some_of
from tests.naming import named
from tests.vision.poses import pose
from tests.vision.scenes import rig, scene
from vergence.errors import ConfigurationError, UnreadableFileError
from vergence.models.camera import light_table
from vergence.vision import AprilTag, Checkerboard, as_grey, make_detector, read_image
from vergence.vision.image import grey_if_channels_equal, has_orientation_tag, open_video

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
"""0 to 235 in steps of 5."""


def test_an_image_in_8_bits_of_grey_is_taken_as_it_is():
    assert as_grey(GREY) is GREY
    np.testing.assert_array_equal(as_grey(GREY[:, :, None]), GREY)
    np.testing.assert_array_equal(as_grey(GREY.tolist()), GREY)


def test_views_come_in_one_piece_of_memory():
    views = [np.s_[::-1], np.s_[:, ::-1], np.s_[::2, ::3], np.s_[1:, 2:5]]
    for view, dtype in some_of(views, [np.uint8, np.uint16, np.float64]):
        with named(view, dtype):
            grey = as_grey(GREY.astype(dtype)[view])
            assert grey.flags.c_contiguous
            np.testing.assert_array_equal(grey, GREY[view])
    np.testing.assert_array_equal(as_grey(GREY.T), GREY.T)


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
            grey = as_grey(image)
            assert grey.shape == (4, 5)
            # ITU-R BT.601, rounded in each channel and in the sum
            assert grey[:, 0] == pytest.approx([0.114 * 255, 0.587 * 255, 0.299 * 255, 255], abs=1)


def test_wide_pixels_are_scaled_by_the_bits_that_hold_the_brightest():
    for bits, dtype in some_of([10, 12, 14, 16], [np.uint16, ">u2", np.int32, np.uint32, np.int64]):
        with named(bits, dtype):
            wide = np.rint(np.linspace(0.0, 2**bits - 1, 256)).astype(dtype).reshape(16, 16)
            np.testing.assert_array_equal(as_grey(wide), np.arange(256).reshape(16, 16))


def test_numbers_up_to_255_are_8_bits_whatever_holds_them():
    for dtype in [np.uint16, np.int16, np.int64, np.float32, np.float64]:
        with named(dtype):
            np.testing.assert_array_equal(as_grey(GREY.astype(dtype)), GREY)


def test_floats_up_to_1_are_shares_of_white():
    """Within one level, since 16 bits of a float hold no level of 8 bits exactly."""
    for dtype in (np.float16, np.float32, np.float64):
        with named(dtype):
            shares = (GREY / 255.0).astype(dtype)
            off = np.abs(as_grey(shares).astype(int) - GREY).max()
            assert off <= (dtype == np.float16)


def test_floats_beyond_255_are_those_of_a_wide_camera():
    np.testing.assert_array_equal(as_grey(GREY * (4095.0 / 235.0)), np.rint(GREY * (255.0 / 235.0)))


def test_bool_is_black_and_white():
    np.testing.assert_array_equal(as_grey(GREY > 100), np.where(GREY > 100, 255, 0))


def test_what_is_not_finite_is_black_or_white_and_changes_no_other_pixel():
    for bad, level in ((np.nan, 0), (np.inf, 255), (-np.inf, 0)):
        with named(bad, level):
            image = GREY.astype(float)
            image[2, 3] = bad
            expected = GREY.copy()
            expected[2, 3] = level
            np.testing.assert_array_equal(as_grey(image), expected)


def test_an_image_of_nan_alone_is_black():
    np.testing.assert_array_equal(as_grey(np.full((4, 5), np.nan)), np.zeros((4, 5)))


def test_a_float_below_0_is_black_and_one_of_any_size_is_taken():
    np.testing.assert_array_equal(as_grey(np.array([[-3.0, 0.0, 255.0, 51.0]])), [[0, 0, 255, 51]])
    assert as_grey(np.array([[0.0, 1e300]])).shape == (1, 2)


def test_a_response_gives_light():
    np.testing.assert_allclose(as_grey(GREY, response="srgb"), light_table("srgb")[GREY])
    assert as_grey(GREY, response="srgb").dtype == np.float32


def test_colours_are_weighted_as_light():
    """Full blue and red with half of the light in green; their levels weigh 0.853 of white."""
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


def test_the_image_given_is_left_as_it_was():
    for image in (GREY.copy(), GREY.astype(np.uint16), np.dstack([GREY] * 3), GREY / 255.0):
        before = image.copy()
        image.setflags(write=False)
        as_grey(image)
        np.testing.assert_array_equal(image, before)


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
        with named(image):
            with pytest.raises(ConfigurationError, match="image: expected") as raised:
                as_grey(image)
            said = str(raised.value)
            assert "got" in said
            assert "\n" not in said
            assert len(said) < 300


def test_an_image_of_another_size_than_the_cameras_is_refused():
    for target, size in some_of(
        [AprilTag(), Checkerboard()], [(480, 640), (640, 479), (1, 1), (1280, 960)]
    ):
        with named(target, size):
            camera, _ = rig("physical")
            detector = make_detector(target, camera)
            image = np.zeros(size[::-1], np.uint8)
            for find in (detector.detect, detector.detect_all, detector.search):
                said = rf"image: expected .* {size[0]} x {size[1]}"
                with pytest.raises(ConfigurationError, match=said):
                    find(image)


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


def test_a_tag_is_found_in_the_same_place_in_an_image_of_more_bits():
    """Within 0.02 px: white is at another level, and the levels are rounded."""
    for bits in (10, 12, 16):
        with named(bits):
            camera, rendering = rig("physical")
            image = scene(camera, AprilTag(), pose(0.02, 0.01, 0.8), rendering).image
            wide = (image.astype(np.uint32) << (bits - 8)).astype(np.uint16)
            detector = make_detector(AprilTag(), camera)
            plain = detector.detect(image)
            for found in (detector.detect(wide), detector.track(wide, plain)):
                assert found.corners_px == pytest.approx(plain.corners_px, abs=0.02)


# files


def encoded(image: np.ndarray, ending: str) -> bytes:
    done, data = cv2.imencode(ending, image)
    assert done
    return data.tobytes()


LARGE = cv2.resize(GREY, (160, 120), interpolation=cv2.INTER_CUBIC)


def test_a_file_without_losses_is_read_as_it_is(tmp_path):
    for ending in [".png", ".tiff", ".bmp", ".pgm"]:
        with named(ending):
            path = tmp_path / f"image{ending}"
            path.write_bytes(encoded(GREY, ending))
            np.testing.assert_array_equal(read_image(path), GREY)
            np.testing.assert_array_equal(read_image(str(path)), GREY)


def test_a_png_of_16_bits_keeps_its_greys(tmp_path):
    for bits in (10, 12, 16):
        for colour in (False, True):
            with named(bits, colour):
                wide = np.rint(np.linspace(0.0, 2**bits - 1, 256)).astype(np.uint16).reshape(16, 16)
                path = tmp_path / "wide.png"
                path.write_bytes(
                    encoded(cv2.cvtColor(wide, cv2.COLOR_GRAY2BGR) if colour else wide, ".png")
                )
                np.testing.assert_array_equal(read_image(path), np.arange(256).reshape(16, 16))


def test_a_png_with_alpha_is_read_as_what_is_drawn_in_it(tmp_path):
    path = tmp_path / "alpha.png"
    path.write_bytes(encoded(np.dstack([GREY, GREY, GREY, np.full_like(GREY, 255)]), ".png"))
    np.testing.assert_array_equal(read_image(path), GREY)


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
    "toml": (b"[head]\nname = 'x'\n", "no image"),
    "png without its end": (encoded(LARGE, ".png")[:-400], "damaged"),
    "png of its first bytes": (encoded(LARGE, ".png")[:30], "damaged"),
    "jpeg of its first bytes": (encoded(LARGE, ".jpg")[:40], "damaged"),
    "jpeg of half": (encoded(LARGE, ".jpg")[: len(encoded(LARGE, ".jpg")) // 2], "damaged"),
    "tiff of half": (encoded(LARGE, ".tiff")[:400], "damaged"), "zeros": (bytes(1000), "no image"),
}  # fmt: skip


def test_a_file_that_is_no_image_is_refused_in_one_line(tmp_path, capfd):
    for damage, (content, said) in DAMAGED.items():
        with named(damage):
            path = tmp_path / "image.png"
            path.write_bytes(content)
            with pytest.raises(UnreadableFileError, match=said) as raised:
                read_image(path)
            assert capfd.readouterr().err == ""  # where the C libraries would write
            assert "image.png" in str(raised.value)
            assert "\n" not in str(raised.value)


def test_a_path_that_is_no_file_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").write_bytes(b"x")
    for path in (
        tmp_path / "nothing.png", tmp_path, tmp_path / "file" / "image.png", f"{tmp_path}/a\0b.png",
    ):  # fmt: skip
        with named(path):
            with pytest.raises(UnreadableFileError) as raised:
                read_image(path)
            assert "\n" not in str(raised.value)

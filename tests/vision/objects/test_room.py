"""The room's images against rays followed to its surfaces one by one."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.models.lenses import wide
from tests.naming import named, refused
from tests.vision.poses import pose
from tests.vision.scenes import rig
from vergence.models.camera import LINEAR, SRGB, light_table
from vergence.vision import Camera
from vergence.vision.objects.room import RoomRenderer, Scene, hit, parse_scene, poster_size_m
from vergence.vision.objects.walls import HIGH_M, LOW_M, PERIODIC_M, PLAIN_M, TILE_M

NOWHERE = np.full((4, 4), np.nan)
AHEAD = np.eye(4)
WAVES = np.array([[0.031, 0.007], [-0.011, 0.027], [0.013, 0.043]])
"""Waves per pixel of a picture along x and y."""


def eye(preset="physical", response=LINEAR):
    """A preset's left eye of half the pixels, for which walls are quick to make."""
    camera, rendering = rig(preset)
    size, matrix = (camera.width // 2, camera.height // 2), camera.matrix * [[0.5], [0.5], [1.0]]
    return replace(camera, size=size, matrix=matrix, response=response), rendering


def looking(yaw, pitch=0.0, roll=0.0, place=(0.1, -0.05, 0.2)):
    """T_0_C of a camera turned from straight ahead, pitch upwards."""
    T = pose(*place)
    turns = [cv2.Rodrigues(np.array(axis))[0]
             for axis in ([0.0, yaw, 0.0], [pitch, 0.0, 0.0], [0.0, 0.0, roll])]  # fmt: skip
    T[:3, :3] = turns[0] @ turns[1] @ turns[2]
    return T


def drawn(camera, scene, rendering, T_0_C=AHEAD, thing=NOWHERE, rng=None, **smears):
    renderer = RoomRenderer(camera, scene, rendering)
    renderer.draw(T_0_C, thing, rng, **smears)
    return renderer.frame


def waves(x, y, fineness=1.0):
    """Light of a picture of waves at pixels of it, 0 to 255."""
    phases = (
        2.0
        * np.pi
        * fineness
        * (np.multiply.outer(x, WAVES[:, 0]) + np.multiply.outer(y, WAVES[:, 1]))
    )
    levels = 130.0 + 25.0 * np.sin(phases + [0.0, 1.0, 2.0]).sum(axis=-1)
    return np.interp(levels, np.arange(256.0), light_table(SRGB))


def waves_file(path, fineness=1.0):
    """File of waves, 500 x 290 px."""
    x, y = np.meshgrid(np.arange(500.0), np.arange(290.0))
    levels = np.interp(waves(x, y, fineness), light_table(SRGB), np.arange(256.0))
    cv2.imwrite(str(path), np.repeat(np.rint(levels).astype(np.uint8)[..., None], 3, axis=2))
    return str(path)


@pytest.fixture
def picture(tmp_path):
    return waves_file(tmp_path / "waves: 1.png")


def pixel_rays(camera):
    """(height, width, 3) rays of all pixels."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.insert(camera.rays(np.column_stack([u.ravel(), v.ravel()]).astype(float)), 2, 1.0, 1)
    return rays.reshape(camera.height, camera.width, 3)


def on_plane(camera, T_C_T):
    """Coordinates x and y, m, of what every pixel sees in the xy plane of T."""
    rays = pixel_rays(camera) @ T_C_T[:3, :3]
    start = -T_C_T[:3, :3].T @ T_C_T[:3, 3]
    points = start - start[2] / rays[..., 2:] * rays
    return points[..., 0], points[..., 1]


def displacement(image, expected, centre, half, blur=0.0):
    """Shift (u, v), px, of an image around a pixel against a sharper one; any gain and offset."""
    seen = cv2.GaussianBlur(image[..., 1].astype(np.float64), (0, 0), 1.5)
    sharp = cv2.GaussianBlur(expected, (0, 0), np.hypot(1.5, blur))
    u, v = np.rint(centre).astype(int)
    part = (slice(v - half, v + half + 1), slice(u - half, u + half + 1))
    blurred = cv2.Laplacian(sharp, cv2.CV_64F)  # what differs by some more blur or less
    rows, columns = np.indices(sharp.shape)
    shades = ((columns - u) * sharp, (rows - v) * sharp)  # of corners of the room
    terms = (*np.gradient(sharp)[::-1], sharp, *shades, blurred, np.ones_like(sharp))
    known = np.column_stack([each[part].ravel() for each in terms])
    du, dv, gain = np.linalg.lstsq(known, seen[part].ravel(), rcond=None)[0][:3]
    return -np.array([du, dv]) / gain


@pytest.mark.slow
def test_a_photograph_on_the_wall_is_where_the_lens_projects_it(tmp_path):
    scene = Scene(wall=waves_file(tmp_path / "waves.png", 1.5))
    for preset in ("physical", "simulated"):
        camera, rendering = eye(preset)
        for T_0_C in (looking(0.0), looking(-0.2, 0.05, 0.2)):
            image = drawn(camera, scene, rendering, T_0_C)
            x, y = on_plane(camera, np.linalg.inv(T_0_C) @ pose(0, 0, HIGH_M[2]))
            light = waves(100.0 * (x - LOW_M[0]) - 0.5, 100.0 * (y - LOW_M[1]) - 0.5, 1.5)
            for off_axis in ((0, 0), (50, -30), (-50, 30)):
                shift = displacement(image, light, camera.principal + off_axis, 30, 0.7)
                with named(preset, off_axis):
                    assert np.abs(shift).max() < 0.02


@pytest.mark.slow
def test_a_poster_is_where_the_lens_projects_it(tmp_path):
    near, far = (
        Scene(picture=waves_file(tmp_path / f"{fineness}.png", fineness), size_m=0.3)
        for fineness in (1.0, 0.3)
    )
    width, height = poster_size_m(near)
    border, per_m = 0.03 * width, 500 / (0.94 * width)
    for preset in ("physical", "simulated"):
        camera, rendering = eye(preset)
        for scene, fineness, thing in (
            (near, 1.0, pose(0.01, 0.02, 0.4)),
            (far, 0.3, pose(0.05, 0.03, 0.8, (0.3, 0.5, 0.4))),
            (far, 0.3, pose(-0.1, 0.06, 1.5, (-0.4, 0.3, 0.1))),
        ):
            image = drawn(camera, scene, rendering, AHEAD, thing)
            x, y = on_plane(camera, thing)
            light = waves(
                (x + 0.5 * width - border) * per_m - 0.5,
                (y + 0.5 * height - border) * per_m - 0.5,
                fineness,
            )
            half = int(min(24.0, 12.0 / thing[2, 3]))
            shift = displacement(image, light, camera.project(thing[None, :3, 3])[0], half, 0.7)
            with named(preset, thing[2, 3]):
                assert np.abs(shift).max() < 0.02


@pytest.mark.slow
def test_every_wall_is_the_same_from_two_places_and_by_another_focal_length():
    camera, rendering = eye("simulated")
    longer = camera.matrix * [[1.3, 1.0, 1.0], [1.0, 1.3, 1.0], [1.0, 1.0, 1.0]]
    other = replace(camera, matrix=longer)
    scene = Scene()
    rays = pixel_rays(camera)[135:296:4, 180:341:4].reshape(-1, 3)
    for yaw, pitch in ((0.0, 0.0), (1.4, 0.0), (-1.5, 0.1), (3.0, 0.0), (0.3, 1.0), (0.2, -1.0)):
        here = looking(yaw, pitch)
        there = looking(yaw + 0.1, pitch - 0.05, 0.1, (-0.1, 0.05, 0.1))
        images = [drawn(each, scene, rendering, T)[..., 1]
                  for each, T in ((camera, here), (other, there))]  # fmt: skip
        first, second = (
            cv2.GaussianBlur(each.astype(np.float32), (0, 0), 2 * k)
            for each, k in zip(images, (1.0, 1.3), strict=True)
        )
        points = np.array([hit(scene, here[:3, 3], ray) for ray in rays @ here[:3, :3].T])
        seen = other.project((points - there[:3, 3]) @ there[:3, :3]).astype(np.float32)
        assert (np.abs(seen - (259.5, 214.5)) < (250.0, 205.0)).all()
        light = cv2.remap(second, seen[None], None, cv2.INTER_CUBIC).ravel()
        down, right, same = (each[135:296:4, 180:341:4].ravel()
                             for each in (*np.gradient(first), first))  # fmt: skip
        known = np.column_stack([right, down, same, np.ones_like(same)])
        du, dv, gain, _ = np.linalg.lstsq(known, light, rcond=None)[0]
        with named(yaw, pitch):
            assert same.std() > 3.0
            assert gain == pytest.approx(1.0, abs=0.1)
            assert np.hypot(du, dv) < 0.04


def test_a_ball_is_the_projection_of_a_lit_sphere():
    camera, rendering = eye()
    rendering = replace(rendering, blur_px=0.0)
    scene = Scene(thing="ball", colour=(255, 128, 64), size_m=0.06)
    renderer = RoomRenderer(camera, scene, rendering)
    renderer.draw(AHEAD, NOWHERE)
    room = renderer.frame.astype(float)
    thing = pose(0.2, -0.12, 0.6)
    renderer.draw(AHEAD, thing)
    parts = 16
    middle = np.rint(camera.project(thing[None, :3, 3])[0]).astype(int)
    fine = (np.arange(-20 * parts, 20 * parts) + 0.5) / parts - 0.5
    u, v = np.meshgrid(fine + middle[0], fine + middle[1])
    rays = np.insert(camera.rays(np.column_stack([u.ravel(), v.ravel()])), 2, 1.0, axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    nearest = rays @ thing[:3, 3]
    squared = nearest**2 - thing[:3, 3] @ thing[:3, 3] + 0.03**2
    cover = squared >= 0.0
    normal = ((nearest - np.sqrt(squared.clip(0)))[:, None] * rays - thing[:3, 3]) / 0.03
    lamp = np.array([-0.45, -0.75, -0.48])
    shade = cover * (0.45 + 0.55 * (normal @ lamp / np.linalg.norm(lamp)).clip(0))
    shade, cover = (each.reshape(40, parts, 40, parts).mean(axis=(1, 3))[..., None]
                    for each in (shade, cover))  # fmt: skip
    light = light_table(SRGB)[[64, 128, 255]] / 255.0 * rendering.white_grey
    rows, columns = (slice(centre - 20, centre + 20) for centre in middle[::-1])
    expected = shade * light + (1.0 - cover) * room[rows, columns]
    error = renderer.frame[rows, columns] - expected
    # a pixel's coverage is that of an edge along its rows or columns
    assert np.abs(cv2.GaussianBlur(error, (0, 0), 0.7)).max() < 4.0
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.2
    assert np.array_equal(renderer.frame[:, : columns.start], room[:, : columns.start])


def test_light_and_shade_keep_a_balls_hue_and_saturation():
    camera, rendering = eye(response=SRGB)
    colour = (255, 128, 40)
    image = drawn(camera, Scene(thing="ball", colour=colour), rendering, AHEAD, pose(0, 0, 0.5))
    u, v = np.rint(camera.project([[0.0, 0.0, 0.5]])[0]).astype(int)
    part = cv2.cvtColor(image[v - 12 : v + 13, u - 12 : u + 13], cv2.COLOR_BGR2HSV).astype(int)
    hue, saturation, _ = cv2.cvtColor(np.uint8([[colour[::-1]]]), cv2.COLOR_BGR2HSV)[0, 0]
    assert np.ptp(part[..., 2]) > 30
    assert np.abs(part[..., 0] - int(hue)).max() <= 2
    assert np.abs(part[..., 1] - int(saturation)).max() <= 16  # sRGB is nearly a power of light


@pytest.mark.slow
def test_the_front_wall_has_a_plain_and_a_periodic_part():
    camera, rendering = eye()

    def seen(box, margin_px):
        corners = np.array([[box[0], box[1], 3.0], [box[2], box[3], 3.0]]) - T_0_C[:3, 3]
        left, top, right, bottom = (
            camera.project(corners @ T_0_C[:3, :3]).ravel().round().astype(int)
        )
        part = image[top + margin_px : bottom - margin_px, left + margin_px : right - margin_px]
        assert part.size > 5_000
        return part.astype(float)

    T_0_C = looking(0.0, place=(0.9, -0.4, 0.0))
    image = drawn(camera, Scene(), rendering, T_0_C)
    assert np.ptp(seen(PLAIN_M, 5), axis=(0, 1)).max() <= 1
    camera = eye("simulated")[0]  # without a lens, a period is the same everywhere
    T_0_C = looking(0.0, place=(-0.8, 0.3, 3.0 - camera.focal[0] * TILE_M / 20))
    image = drawn(camera, Scene(), rendering, T_0_C)
    part = seen(PERIODIC_M, 8)
    assert part.std() > 5.0
    assert np.abs(part[:, 20:] - part[:, :-20]).mean() < 1.0


@pytest.mark.slow
def test_noise_and_motion():
    camera, rendering = eye()
    rng = np.random.default_rng(1)
    thing = pose(0.0, 0.0, 0.6)
    renderer = RoomRenderer(camera, Scene(size_m=0.3), rendering)

    def frame(*arguments, **options):
        renderer.draw(AHEAD, thing, *arguments, **options)
        return renderer.frame.astype(float)

    still = frame()
    noise = frame(rng) - still
    assert abs(noise.std() / rendering.noise_grey - 1.0) < 0.02
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.02
    moved = frame(room_smear_px=(8.0, 0.0))
    middle = (slice(80, 150), slice(140, 220))  # well inside the poster
    assert np.array_equal(moved[middle], still[middle])
    across, along = (
        np.abs(np.diff(moved[:60], axis=axis)).mean()
        / np.abs(np.diff(still[:60], axis=axis)).mean()
        for axis in (0, 1)
    )
    assert along < 0.7 * across
    moved = frame(smear_px=(0.0, 3.0))
    assert np.array_equal(moved[:40], still[:40])
    assert (
        np.abs(np.diff(moved[middle], axis=0)).mean()
        < 0.8 * np.abs(np.diff(still[middle], axis=0)).mean()
    )


def test_a_thing_that_is_not_in_view_leaves_the_room_as_it_is():
    camera, rendering = eye()
    for scene in (Scene(thing="ball"), Scene()):
        renderer = RoomRenderer(camera, scene, rendering)
        renderer.draw(AHEAD, NOWHERE)
        room = renderer.frame.copy()
        for thing in (pose(0, 0, -1), pose(5, 0, 1), pose(0, 0, 0.001), pose(0, -3, 1)):
            renderer.draw(AHEAD, thing)
            assert np.array_equal(renderer.frame, room)
        renderer.draw(AHEAD, pose(0, 0, 1))
        assert not np.array_equal(renderer.frame, room)
    renderer.draw(AHEAD, pose(0, 0, 1, (0, np.pi, 0)))  # a poster's back
    assert np.array_equal(renderer.frame, room)


def test_a_ball_passes_the_border_of_the_image():
    camera, rendering = eye()
    renderer = RoomRenderer(camera, Scene(thing="ball"), rendering)
    for u in np.arange(-14.0, -4.0, 0.25):
        renderer.draw(AHEAD, pose(*(8.0 * np.append(camera.rays([[u, 100.0]])[0], 1.0))))


def test_a_ray_hits_the_thing_or_the_wall_behind_it():
    ball, poster = Scene(thing="ball", size_m=0.1), Scene(size_m=0.2)
    for scene, thing, expected in (
        (ball, pose(0, 0, 1), [0, 0, 0.95]), (poster, pose(0, 0, 1), [0, 0, 1]),
        (ball, pose(0.06, 0, 1), [0, 0, 3]), (poster, pose(0.11, 0, 1), [0, 0, 3]),
        (ball, pose(0, 0, -1), [0, 0, 3]), (poster, pose(0, 0, -1), [0, 0, 3]),
        (ball, NOWHERE, [0, 0, 3]), (poster, None, [0, 0, 3]),
    ):  # fmt: skip
        assert np.allclose(hit(scene, [0, 0, 0], [0, 0, 2], thing), expected)
    assert np.allclose(hit(ball, [0.5, 0, 0], [1, 0, 0.5]), [2.5, 0, 1])


def test_a_scene_is_what_its_text_says(picture, tmp_path):
    orange = Scene(thing="ball", colour=(255, 128, 0), size_m=0.08)
    for text, scene in (
        ("ball", orange), ("ball:#ff8000", orange),
        ("ball:#00fF10", replace(orange, colour=(0, 255, 16))),
        ("ball:#ff8000:55.5", replace(orange, size_m=0.0555)),
        ("poster", Scene(size_m=0.3)), ("poster:200", Scene(size_m=0.2)),
        (f"poster:{picture}", Scene(size_m=0.3, picture=picture)),
        (f"poster:{picture}:200", Scene(size_m=0.2, picture=picture)),
    ):  # fmt: skip
        with named(text):
            assert parse_scene(text) == scene
            assert parse_scene(str(scene)) == scene
    assert parse_scene("ball", picture).wall == picture
    numbered = waves_file(tmp_path / "no:2.png")
    Path(numbered).rename(tmp_path / "no:2")
    assert parse_scene(f"poster:{tmp_path / 'no:2'}").picture == str(tmp_path / "no:2")


def test_a_scene_that_cannot_be_is_refused(tmp_path):
    text = tmp_path / "text.png"
    text.write_text("no image")
    for bad in ("", "cube", "ball:red", "ball:#ff80", "ball:#ff8000:-3", "ball:#ff8000:80:1",
                "ball:#ff8000:nan", "poster:5000", "poster:gone.png",
                f"poster:{text}"):  # fmt: skip
        refused("scene: ", parse_scene, bad)
    refused("wall: ", parse_scene, "ball", str(tmp_path / "gone.png"))


def test_grey_levels_out_of_order_are_refused():
    camera, rendering = eye()
    for change in ({"black_grey": 200.0}, {"white_grey": 300.0}, {"noise_grey": -1.0}):
        refused("rendering: ", RoomRenderer, camera, Scene(), replace(rendering, **change))


def test_a_camera_without_a_stated_response_follows_srgb():
    camera, rendering = eye(response=None)
    assert isinstance(camera, Camera)
    images = [drawn(replace(camera, response=each), Scene(), rendering) for each in (None, SRGB)]
    assert np.array_equal(*images)


@pytest.mark.slow
def test_wide_lenses_and_large_images_are_drawn():
    rendering = rig("physical")[1]
    fisheye = Camera.of(wide("fisheye"), 0)
    large = Camera(size=(1920, 1080), matrix=[[900.0, 0, 960], [0, 900, 540], [0, 0, 1]])
    for camera in (fisheye, large):
        rng = np.random.default_rng(0)
        image = drawn(camera, Scene(size_m=0.3), rendering, AHEAD, pose(0.4, 0, 0.8), rng)
        assert image.std() > 10.0
        assert np.array_equal(image.shape, (camera.height, camera.width, 3))

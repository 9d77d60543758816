"""The room's images against rays followed to its surfaces one by one."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

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
    camera, rendering = rig(preset)
    return replace(camera, response=response), rendering


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


def waves(x, y):
    """Light of the picture of waves at pixels of it, 0 to 255."""
    phases = 2.0 * np.pi * (np.multiply.outer(x, WAVES[:, 0]) + np.multiply.outer(y, WAVES[:, 1]))
    levels = 130.0 + 25.0 * np.sin(phases + [0.0, 1.0, 2.0]).sum(axis=-1)
    return np.interp(levels, np.arange(256.0), light_table(SRGB))


@pytest.fixture
def picture(tmp_path):
    """File of waves, 500 x 290 px."""
    x, y = np.meshgrid(np.arange(500.0), np.arange(290.0))
    levels = np.interp(waves(x, y), light_table(SRGB), np.arange(256.0))
    path = tmp_path / "waves: 1.png"
    cv2.imwrite(str(path), np.repeat(np.rint(levels).astype(np.uint8)[..., None], 3, axis=2))
    return str(path)


def hits(camera, scene, T_0_C, pixels, thing=None):
    rays = np.insert(camera.rays(pixels), 2, 1.0, axis=1) @ T_0_C[:3, :3].T
    return np.array([hit(scene, T_0_C[:3, 3], ray, thing) for ray in rays])


def grid(centre, half=24, step=3):
    u, v = np.meshgrid(*(np.arange(-half, half + 1.0, step) + middle for middle in centre))
    return np.column_stack([u.ravel(), v.ravel()])


def displacement(image, at, expected):
    """Shift (u, v), px, of an image against light expected at pixels of it; any gain and offset."""
    smooth = cv2.GaussianBlur(image[..., 1].astype(np.float32), (0, 0), 1.5)
    down, right = np.gradient(smooth)
    rows, columns = np.rint(at[:, 1]).astype(int), np.rint(at[:, 0]).astype(int)
    known = [each[rows, columns] for each in (right, down)] + [expected, np.ones(len(at))]
    return -np.linalg.lstsq(np.column_stack(known), smooth[rows, columns], rcond=None)[0][:2]


def test_a_photograph_on_the_wall_is_where_the_lens_projects_it(picture):
    for preset in ("physical", "simulated"):
        camera, rendering = eye(preset)
        scene = Scene(wall=picture)
        for T_0_C in (looking(0.0), looking(0.3, 0.1, 0.2)):
            image = drawn(camera, scene, rendering, T_0_C)
            for centre in ((320, 240), (420, 140), (230, 300)):
                pixels = grid(centre)
                points = hits(camera, scene, T_0_C, pixels)
                assert np.allclose(points[:, 2], HIGH_M[2])
                x, y = (points[:, :2] - LOW_M[:2]).T * 100.0 - 0.5  # 5 m in 500 px
                with named(preset, centre):
                    shift = displacement(image, pixels, waves(x, y))
                    assert np.abs(shift).max() < 0.02


def test_a_poster_is_where_the_lens_projects_it(picture):
    scene = Scene(picture=picture, size_m=0.3)
    width, height = poster_size_m(scene)
    border, per_m = 0.03 * width, 500 / (0.94 * width)
    for preset in ("physical", "simulated"):
        camera, rendering = eye(preset)
        for thing in (
            pose(0.01, 0.02, 0.4), pose(0.05, 0.03, 0.8, (0.3, 0.5, 0.4)),
            pose(-0.1, 0.06, 1.5, (-0.4, 0.3, 0.1)),
        ):  # fmt: skip
            image = drawn(camera, scene, rendering, AHEAD, thing)
            half = int(30 * min(1.0, 0.8 / thing[2, 3]))
            pixels = grid(np.rint(camera.project(thing[None, :3, 3])[0]), half, 2)
            points = hits(camera, scene, AHEAD, pixels, thing)
            on_poster = (points - thing[:3, 3]) @ thing[:3, :3]
            assert np.allclose(on_poster[:, 2], 0.0)
            x = (on_poster[:, 0] + 0.5 * width - border) * per_m - 0.5
            y = (on_poster[:, 1] + 0.5 * height - border) * per_m - 0.5
            with named(preset, thing[2, 3]):
                assert np.abs(displacement(image, pixels, waves(x, y))).max() < 0.02


def test_every_wall_is_the_same_from_two_places():
    camera, rendering = eye("simulated")
    scene = Scene()
    for yaw, pitch in ((0.0, 0.0), (1.4, 0.0), (-1.5, 0.1), (3.0, 0.0), (0.3, 1.0), (0.2, -1.0)):
        here = looking(yaw, pitch)
        there = looking(yaw + 0.1, pitch - 0.05, 0.1, (-0.1, 0.05, 0.1))
        first, second = (drawn(camera, scene, rendering, T).astype(np.float32)
                         for T in (here, there))  # fmt: skip
        pixels = grid((520, 430), 90, 2)
        points = hits(camera, scene, here, pixels)
        seen = camera.project((points - there[:3, 3]) @ there[:3, :3]).astype(np.float32)
        smooth = cv2.GaussianBlur(second[..., 1], (0, 0), 1.5)
        expected = cv2.remap(smooth, seen[None], None, cv2.INTER_CUBIC)[0]
        with named(yaw, pitch):
            assert expected.std() > 3.0
            assert np.abs(displacement(first, pixels, expected)).max() < 0.04


def test_a_ball_is_the_projection_of_a_lit_sphere():
    camera, rendering = eye()
    rendering = replace(rendering, blur_px=0.0)
    scene = Scene(thing="ball", colour=(255, 128, 64), size_m=0.1)
    renderer = RoomRenderer(camera, scene, rendering)
    renderer.draw(AHEAD, NOWHERE)
    room = renderer.frame.astype(float)
    thing = pose(0.2, -0.12, 0.6)
    renderer.draw(AHEAD, thing)
    parts = 6
    middle = np.rint(camera.project(thing[None, :3, 3])[0]).astype(int)
    fine = (np.arange(-60 * parts, 60 * parts) + 0.5) / parts - 0.5
    u, v = np.meshgrid(fine + middle[0], fine + middle[1])
    rays = np.insert(camera.rays(np.column_stack([u.ravel(), v.ravel()])), 2, 1.0, axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    nearest = rays @ thing[:3, 3]
    squared = nearest**2 - thing[:3, 3] @ thing[:3, 3] + 0.05**2
    cover = squared >= 0.0
    normal = ((nearest - np.sqrt(squared.clip(0)))[:, None] * rays - thing[:3, 3]) / 0.05
    lamp = np.array([-0.45, -0.75, -0.48])
    shade = cover * (0.45 + 0.55 * (normal @ lamp / np.linalg.norm(lamp)).clip(0))
    shade, cover = (each.reshape(120, parts, 120, parts).mean(axis=(1, 3))[..., None]
                    for each in (shade, cover))  # fmt: skip
    light = light_table(SRGB)[[64, 128, 255]] / 255.0 * rendering.white_grey
    rows, columns = (slice(centre - 60, centre + 60) for centre in middle[::-1])
    expected = shade * light + (1.0 - cover) * room[rows, columns]
    error = renderer.frame[rows, columns] - expected
    # a pixel's coverage is that of an edge along its rows or columns
    assert np.abs(cv2.GaussianBlur(error, (0, 0), 0.7)).max() < 3.0
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.2
    assert np.array_equal(renderer.frame[:, : columns.start], room[:, : columns.start])


def test_light_and_shade_keep_a_balls_hue_and_saturation():
    camera, rendering = eye(response=SRGB)
    colour = (255, 128, 40)
    image = drawn(camera, Scene(thing="ball", colour=colour), rendering, AHEAD, pose(0, 0, 0.5))
    u, v = np.rint(camera.project([[0.0, 0.0, 0.5]])[0]).astype(int)
    part = cv2.cvtColor(image[v - 24 : v + 25, u - 24 : u + 25], cv2.COLOR_BGR2HSV).astype(int)
    hue, saturation, _ = cv2.cvtColor(np.uint8([[colour[::-1]]]), cv2.COLOR_BGR2HSV)[0, 0]
    assert np.ptp(part[..., 2]) > 30
    assert np.abs(part[..., 0] - int(hue)).max() <= 2
    assert np.abs(part[..., 1] - int(saturation)).max() <= 16  # sRGB is nearly a power of light


def test_the_front_wall_has_a_plain_and_a_periodic_part():
    camera, rendering = eye()

    def seen(box, margin_px):
        corners = np.array([[box[0], box[1], 3.0], [box[2], box[3], 3.0]]) - T_0_C[:3, 3]
        left, top, right, bottom = camera.project(corners @ T_0_C[:3, :3]).ravel().round().astype(int)
        part = image[top + margin_px : bottom - margin_px, left + margin_px : right - margin_px]
        assert part.size > 20_000
        return part.astype(float)

    T_0_C = looking(0.0, place=(0.9, -0.4, 0.0))
    image = drawn(camera, Scene(), rendering, T_0_C)
    assert np.ptp(seen(PLAIN_M, 5), axis=(0, 1)).max() <= 1
    camera = rig("simulated")[0]  # without a lens, a period is the same everywhere
    T_0_C = looking(0.0, place=(-0.8, 0.3, 3.0 - camera.focal[0] * TILE_M / 20))
    image = drawn(camera, Scene(), rendering, T_0_C)
    part = seen(PERIODIC_M, 8)
    assert part.std() > 5.0
    assert np.abs(part[:, 20:] - part[:, :-20]).mean() < 1.0


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
    moved = frame(room_smear_px=(6.0, 0.0))
    middle = (slice(160, 300), slice(280, 440))  # well inside the poster
    assert np.array_equal(moved[middle], still[middle])
    across, along = (np.abs(np.diff(moved[:120], axis=axis)).mean()
                     / np.abs(np.diff(still[:120], axis=axis)).mean() for axis in (0, 1))  # fmt: skip
    assert along < 0.6 * across
    moved = frame(smear_px=(0.0, 6.0))
    assert np.array_equal(moved[:100], still[:100])
    assert np.abs(np.diff(moved[middle], axis=0)).mean() < 0.8 * np.abs(
        np.diff(still[middle], axis=0)
    ).mean()


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


def test_a_scene_is_what_its_text_says(picture):
    orange = Scene(thing="ball", colour=(255, 128, 0), size_m=0.08)
    for text, scene in (
        ("ball", orange), ("ball:#ff8000", orange), ("ball:#00fF10", replace(orange, colour=(0, 255, 16))),
        ("ball:#ff8000:55.5", replace(orange, size_m=0.0555)),
        ("poster", Scene(size_m=0.3)), ("poster:200", Scene(size_m=0.2)),
        (f"poster:{picture}", Scene(size_m=0.3, picture=picture)),
        (f"poster:{picture}:200", Scene(size_m=0.2, picture=picture)),
    ):  # fmt: skip
        with named(text):
            assert parse_scene(text) == scene
            assert parse_scene(str(scene)) == scene
    assert parse_scene("ball", picture).wall == picture


def test_a_scene_that_cannot_be_is_refused(tmp_path):
    text = tmp_path / "text.png"
    text.write_text("no image")
    for bad in ("", "cube", "ball:red", "ball:#ff80", "ball:#ff8000:-3", "ball:#ff8000:80:1",
                "ball:#ff8000:nan", "poster:5000", "poster:gone.png", f"poster:{text}"):  # fmt: skip
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

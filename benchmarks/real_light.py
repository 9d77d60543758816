"""Measure the errors of tag corners and of depth by PnP in simulated webcam images.

Run ``python -m benchmarks.real_light``, with ``--csv FILE`` to keep the table. Corner errors
are compared with the sigmas that the detector states. The renderer shares no code with
`vergence.vision.drawing`. It simulates many rays per pixel through a pinhole onto a flat or bent
sheet, Gaussian blur, lateral chromatic aberration, a sensor with Bayer mosaic, shot noise and
clipping, demosaicking, the camera's response, and JPEG.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vergence.vision import AprilTag, make_detector
from vergence.vision.tag_families import tag_family

_FINER: Final = 8
"""Rays per pixel along each axis (numerical)."""
_AROUND_PX: Final = 8
"""Margin drawn around the sheet, px (numerical)."""
_EDGE_M: Final = 0.12
"""Edge of the tag, m (chosen: a usual printed tag)."""
_LARGE_PX: Final = 60.0
"""Edge above which a tag counts as large, px (chosen: splits the drawn tags)."""
_WHITE, _BLACK, _WALL = 0.8, 0.03, 0.35
"""Reflectances of paper, ink and surroundings."""
Image = NDArray[Any]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera model: conversion of light to grey levels."""

    response: str = "srgb"
    exposure: float = 0.9
    """Level of white paper relative to the sensor's saturation; clipped above 1."""
    electrons: float = 8000.0
    """Electrons of a saturated pixel; sets the shot noise."""
    read_electrons: float = 5.0
    bayer: bool = True
    jpeg: int | None = None
    """JPEG quality; None for no compression."""
    chromatic: float = 0.0
    """Lateral chromatic aberration: excess scale of red, and deficit of blue, relative to green."""
    size: tuple[int, int] = (640, 480)
    focal_px: float = 600.0


class Scene(NamedTuple):
    """A sheet with a tag in front of a camera."""

    identity: int
    pose: Floats
    """(4, 4) pose of the sheet in the camera's frame, m."""
    blur_px: float
    bend_m: float
    """Height of the middle of a 150 mm sheet above its edges, m."""
    bend_rad: float
    """Direction of the cylinder's axis in the sheet, rad."""


def drawn_scene(rng: np.random.Generator, camera: Camera, bend_m: float = 0.0) -> Scene:
    """Random tag, 30 to 160 px wide, rotated, tilted by up to 45 degrees, entirely in the image."""
    edge_px = float(np.exp(rng.uniform(np.log(30.0), np.log(160.0))))
    depth = camera.focal_px * _EDGE_M / edge_px
    tilt, about, roll = rng.uniform(0, np.pi / 4), rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1)
    turn = cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0.0]))[0]
    pose = np.eye(4)
    pose[:3, :3] = turn @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    reach = 0.5 * np.array(camera.size) - 1.0 * edge_px - 8.0
    place = rng.uniform(-1, 1, 2) * np.maximum(reach, 2.0)
    pose[:3, 3] = (*(place * depth / camera.focal_px), depth)
    identity = int(rng.integers(587))
    return Scene(identity, pose, rng.uniform(0.5, 1.0), bend_m, rng.uniform(0, np.pi))


def on_sheet(scene: Scene, rays: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Intersections of rays with the sheet, metres from its middle, and a mask of valid ones."""
    turn, origin = scene.pose[:3, :3], scene.pose[:3, 3]
    ray, eye = rays @ turn, -origin @ turn
    if scene.bend_m == 0.0:
        t = -eye[2] / ray[..., 2]
        return eye[:2] + t[..., None] * ray[..., :2], t > 0.0
    cosine, sine = np.cos(scene.bend_rad), np.sin(scene.bend_rad)
    along = np.array([[cosine, sine], [-sine, cosine]])
    # with the cylinder's axis along y, behind the paper
    ray, eye = ray.copy(), eye.copy()
    ray[..., :2], eye[:2] = ray[..., :2] @ along.T, along @ eye[:2]
    radius = _radius(scene)
    away = eye[2] - radius
    a = ray[..., 0] ** 2 + ray[..., 2] ** 2
    b = eye[0] * ray[..., 0] + away * ray[..., 2]
    root = b * b - a * (eye[0] ** 2 + away**2 - radius**2)
    t = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    x = radius * np.arctan2(eye[0] + t * ray[..., 0], radius - eye[2] - t * ray[..., 2])
    return np.stack([x, eye[1] + t * ray[..., 1]], axis=-1) @ along, root > 0.0


def _radius(scene: Scene) -> float:
    return 0.075**2 / (2.0 * scene.bend_m)


def in_space(scene: Scene, sheet: Floats) -> Floats:
    """(n, 3) points in the camera's frame of (n, 2) points on the sheet, m."""
    if scene.bend_m == 0.0:
        bent = np.column_stack([sheet, np.zeros(len(sheet))])
    else:
        cosine, sine = np.cos(scene.bend_rad), np.sin(scene.bend_rad)
        along = np.array([[cosine, sine], [-sine, cosine]])
        x, y = along @ sheet.T
        radius = _radius(scene)
        flat = np.stack([radius * np.sin(x / radius), y], axis=-1) @ along
        bent = np.column_stack([flat, radius * (1.0 - np.cos(x / radius))])
    return np.asarray(bent @ scene.pose[:3, :3].T + scene.pose[:3, 3])


def light_of(scene: Scene, camera: Camera) -> Floats:
    """(height, width, 3) light in blue, green, red, relative to the light that paper reflects."""
    code = tag_family("36h11")
    cells = np.pad(code.cells(scene.identity) / 255.0, 1, constant_values=1.0)
    cell_m = _EDGE_M / code.width_at_border
    half = 0.5 * cell_m * len(cells)
    sheet = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.0, 0.0]])
    seen = in_space(scene, sheet)
    middle = 0.5 * (np.array(camera.size) - 1.0)
    place = camera.focal_px * seen[:, :2] / seen[:, 2:] + middle
    first = np.maximum(np.floor(place.min(axis=0)).astype(int) - _AROUND_PX, 0)
    end = np.minimum(np.ceil(place.max(axis=0)).astype(int) + _AROUND_PX, camera.size)
    out = np.full((*camera.size[::-1], 3), _WALL / _WHITE)
    u, v = (
        np.arange(low * _FINER, high * _FINER) / _FINER + 0.5 / _FINER - 0.5
        for low, high in zip(first, end, strict=True)
    )
    size = end - first
    before = 0.0
    for channel, scale in enumerate((1.0 - camera.chromatic, 1.0, 1.0 + camera.chromatic)):
        if scale != before:
            x, y = (
                (pixel - centre) / scale / camera.focal_px
                for pixel, centre in zip((u, v), middle, strict=True)
            )
            rays = np.stack([*np.meshgrid(x, y), np.ones((len(v), len(u)))], axis=-1)
            sheet, there = on_sheet(scene, rays)
            at = np.floor(sheet / cell_m + 0.5 * len(cells)).astype(int)
            there &= ((at >= 0) & (at < len(cells))).all(axis=-1)
            fine = np.full(there.shape, _WALL / _WHITE)
            inside = at[there]
            ink = _BLACK / _WHITE
            fine[there] = ink + (1.0 - ink) * cells[inside[:, 1], inside[:, 0]]
            fine = cv2.GaussianBlur(fine, (0, 0), scene.blur_px * _FINER)
            drawn = fine.reshape(size[1], _FINER, size[0], _FINER).mean(axis=(1, 3))
            before = scale
        out[first[1] : end[1], first[0] : end[0], channel] = drawn
    return out


def encoded(light: Floats, response: str) -> Floats:
    """Levels from 0 to 1 of light from 0 to 1: linear, sRGB (IEC 61966-2-1), or a gamma."""
    if response == "linear":
        return light
    if response == "srgb":
        low, high = 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
        return np.where(light <= 0.0031308, low, high)
    return np.asarray(light ** (1.0 / float(response)))


def photographed(light: Floats, camera: Camera, rng: np.random.Generator) -> Image:
    """(height, width, 3) 8-bit image in blue, green, red that a camera makes of light."""
    exposed = camera.exposure * light
    if camera.bayer:
        mosaic = exposed[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = exposed[::2, ::2, 2], exposed[1::2, 1::2, 0]
        exposed = mosaic
    count = rng.poisson(np.maximum(exposed, 0.0) * camera.electrons).astype(float)
    count += rng.normal(0.0, camera.read_electrons, count.shape)
    raw = np.clip(count / camera.electrons, 0.0, 1.0)
    if camera.bayer:
        sixteen = np.rint(raw * 65535.0).astype(np.uint16)
        # OpenCV names the pattern by its second row and column: this one begins red, green
        colour = cv2.cvtColor(sixteen, cv2.COLOR_BayerBG2BGR_EA).astype(float)
        raw = colour / 65535.0
    levels = np.rint(255.0 * encoded(raw, camera.response)).astype(np.uint8)
    if camera.jpeg is not None:
        _, data = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
        levels = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return levels


PLAIN: Final = Camera()
CAMERAS: Final = {
    "linear": Camera(response="linear", bayer=False),
    "srgb": Camera(bayer=False),
    "srgb, clipped 1.2": Camera(bayer=False, exposure=1.2),
    "srgb, clipped 2": Camera(bayer=False, exposure=2.0),
    "srgb, Bayer": PLAIN,
    "srgb, JPEG 85": Camera(bayer=False, jpeg=85),
    "srgb, chromatic": Camera(bayer=False, chromatic=0.001),
    "srgb, Bayer, JPEG 85, chromatic": Camera(jpeg=85, chromatic=0.001),
    "all": Camera(exposure=1.2, jpeg=85, chromatic=0.001),
    "all, much noise": Camera(exposure=1.2, jpeg=85, chromatic=0.001, electrons=1000.0),
}
BENDS_MM: Final = (0.0, 1.0, 2.0, 4.0)
"""Heights of bent sheets, see `Scene.bend_m`, mm (chosen: flat to clearly bent)."""


def figures(
    camera: Camera, bend_mm: float, count: int, seed: int, response: str | None
) -> dict[str, float]:
    """Errors of the corners and depths of random tags.

    Returns:
        Numbers of drawn and found tags; rms of errors and sigmas, px; mean of (error / sigma)^2 of
        all, small and large tags, and its median over tags; relative error of depth by PnP in per
        cent: mean, rms, and median of its absolute value.
    """
    rng = np.random.default_rng(seed)
    half = 0.5 * _EDGE_M
    flat = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    board = np.column_stack([flat, np.zeros(4)])
    width, height = camera.size
    matrix = np.array(
        [[camera.focal_px, 0, 0.5 * (width - 1)], [0, camera.focal_px, 0.5 * (height - 1)],
         [0, 0, 1.0]]
    )  # fmt: skip
    errors, sigmas, depths, large = [], [], [], []
    for _ in range(count):
        scene = drawn_scene(rng, camera, bend_mm / 1000.0)
        image = photographed(light_of(scene, camera), camera, rng)
        seen = make_detector(
            AprilTag(family="36h11", id=scene.identity, edge_m=_EDGE_M), response=response
        ).detect(image)
        if seen is None:
            continue
        true = in_space(scene, flat) @ matrix.T
        errors.append(seen.corners_px - true[:, :2] / true[:, 2:])
        sigmas.append(seen.corners_sigma_px)
        large.append(camera.focal_px * _EDGE_M / scene.pose[2, 3] > _LARGE_PX)
        _, _, place = cv2.solvePnP(board, seen.corners_px, matrix, None)
        depths.append(100.0 * (float(place[2, 0]) / scene.pose[2, 3] - 1.0))
    error, sigma, depth = np.array(errors), np.array(sigmas), np.array(depths)
    of_tag = ((error / sigma) ** 2).mean(axis=(1, 2))
    is_large = np.array(large)
    return {
        "tags": count,
        "found": len(error),
        "error_rms_px": float(np.sqrt((error**2).mean())),
        "sigma_rms_px": float(np.sqrt((sigma**2).mean())),
        "normalised": float(of_tag.mean()),
        "normalised_small": float(of_tag[~is_large].mean()),
        "normalised_large": float(of_tag[is_large].mean()),
        "normalised_median_of_tag": float(np.median(of_tag)),
        "depth_mean_percent": float(depth.mean()),
        "depth_rms_percent": float(np.sqrt((depth**2).mean())),
        "depth_median_abs_percent": float(np.median(np.abs(depth))),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tags", type=int, default=100, help="drawn in each row")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", nargs="*", help="names of rows; all by default")
    parser.add_argument("--csv", type=Path, help="file for the table")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    cases = [(name, camera, 0.0) for name, camera in CAMERAS.items()]
    sharp = replace(PLAIN, jpeg=85)
    cases += [(f"bent {bend:g} mm", sharp, bend) for bend in BENDS_MM]
    rows = []
    for name, camera, bend in cases:
        if given.rows and name not in given.rows:
            continue
        row = {"image": name, **figures(camera, bend, given.tags, given.seed, camera.response)}
        rows.append(row)
        print(*(f"{k} {v:.3f}" if isinstance(v, float) else v for k, v in row.items()), flush=True)
    if given.csv is not None:
        pd.DataFrame(rows).to_csv(given.csv, index=False, float_format="%.6g")


if __name__ == "__main__":
    main()

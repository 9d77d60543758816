"""Measure the errors of drawn pixels against ray casting, by the board's viewing angle.

Run ``python -m benchmarks.ray_cast``: it uses the rigs of the presets without noise and a board at
0.8 m, tilted about three axes in the image. The worst error of the three is printed, in per cent of
the contrast.
"""

import time
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.detector import RIGS, TARGETS, Row, show
from vergence import load_head
from vergence.models.parts import Rendering
from vergence.vision import Camera, PlanarTarget, TargetRenderer, make_planar_target

RAYS = 16
"""Rays per pixel along each axis in the reference; places an edge to 1/32 px."""
MARGIN = 5
INCIDENCES_DEG = (0.0, 30.0, 45.0, 52.0, 60.0, 67.0, 75.0, 80.0)
DIRECTIONS_RAD = (0.0, 0.8, 1.57)


def ray_cast(
    camera: Camera,
    target: PlanarTarget,
    rendering: Rendering,
    T_C_T: NDArray[np.float64],
    region: tuple[int, int, int, int],
) -> NDArray[np.float64]:
    """Grey levels of a region by intersecting rays with the plane; blur acts on the rays' image."""
    x0, y0, x1, y1 = region[0] - MARGIN, region[1] - MARGIN, region[2] + MARGIN, region[3] + MARGIN
    u = x0 - 0.5 + (np.arange((x1 - x0) * RAYS) + 0.5) / RAYS
    v = y0 - 0.5 + (np.arange((y1 - y0) * RAYS) + 0.5) / RAYS
    pixels = np.stack(np.meshgrid(u, v), axis=-1)
    rays = camera.rays(pixels.reshape(-1, 2)).reshape(pixels.shape)
    directions = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    origin, normal = T_C_T[:3, 3], T_C_T[:3, 2]
    points = directions * (origin @ normal / (directions @ normal))[..., None] - origin
    cell = np.floor(points @ T_C_T[:3, :2] / target.cell_m + target.origin_cells).astype(int)
    rows, columns = target.cells.shape
    on_board = ((cell >= 0) & (cell < (columns, rows))).all(axis=-1)
    grey = np.full(on_board.shape, rendering.background_grey)
    white = target.cells[cell[on_board][:, 1], cell[on_board][:, 0]] > 0
    grey[on_board] = np.where(white, rendering.white_grey, rendering.black_grey)
    grey = cv2.GaussianBlur(grey, (0, 0), rendering.blur_px * RAYS)
    pixel_means = grey.reshape(y1 - y0, RAYS, x1 - x0, RAYS).mean(axis=(1, 3))
    return pixel_means[MARGIN:-MARGIN, MARGIN:-MARGIN]


def steep_row(rig: str, name: str, incidence_deg: float) -> Row:
    """Row with the worst error over the directions of the tilt, and the time of drawing."""
    head = load_head(rig)
    camera, target = Camera.of(head, 0), make_planar_target(name)
    rendering = replace(head.rendering, noise_grey=0.0)
    drawing, contrast = (
        TargetRenderer(camera, target, rendering),
        rendering.white_grey - rendering.black_grey,
    )
    rms, most, times = [], [], []
    for direction in DIRECTIONS_RAD:
        tilt = np.deg2rad(incidence_deg) * np.array([np.cos(direction), np.sin(direction), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(tilt)[0]
        pose[:3, 3] = (0.02, 0.03, 0.8)
        for _ in range(2):  # the first call also makes textures and tables
            begun = time.perf_counter()
            drawing.draw(pose)
            spent = time.perf_counter() - begun
        assert drawing.region is not None
        x0, y0, x1, y1 = drawing.region
        true = ray_cast(camera, target, rendering, pose, drawing.region)
        error = 100.0 * (drawing.frame[y0:y1, x0:x1] - true) / contrast
        rms.append(float(np.sqrt(np.mean(error**2))))
        most.append(float(np.abs(error).max()))
        times.append(spent)
    return {
        "rig": rig,
        "target": name,
        "incidence_deg": incidence_deg,
        "rms_percent": round(max(rms), 2),
        "max_percent": round(max(most), 1),
        "draw_ms": round(1e3 * float(np.mean(times)), 2),
    }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    show(
        "drawing",
        [
            steep_row(*case, angle)
            for case in ((rig, name) for rig in RIGS for name in TARGETS)
            for angle in INCIDENCES_DEG
        ],
    )

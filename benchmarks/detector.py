"""Measure noise, bias, motion blur, response errors and run time of the detectors, for both rigs.

Run ``python benchmarks/detector.py``, with ``--json FILE`` to keep the tables. The noise is the
sample standard deviation over draws of the image noise at a fixed pose. The bias is
|detected - true| over random poses, without image noise, and does not average out. Cameras and
rendering are those of the presets.
"""

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence import load_head
from vergence.models.camera import Camera
from vergence.vision import TargetRenderer, make_detector, make_planar_target

DEPTHS_M = (0.5, 1.0, 1.5, 2.0, 2.5)
CORNER_DEPTHS_M = (0.4, 0.7, 1.0, 1.5, 2.0, 2.4, 3.2, 4.0)
MAX_TILT_RAD = np.radians(30.0)
TARGETS = ("tag", "checkerboard")
RIGS = ("simulated", "physical")
Row = dict[str, str | float]


class Eye:
    """The left eye of a rig, with one target."""

    def __init__(self, rig: str, name: str) -> None:
        """Make the drawing and the detector."""
        head = load_head(rig)
        self.camera = Camera.of(head, 0)
        target = make_planar_target(name)
        self.drawing = TargetRenderer(self.camera, target, head.rendering)
        self.detector = make_detector(target, self.camera)

    def true_px(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Projection of the measured point, shape (2,)."""
        return self.camera.project(pose[None, :3, 3])[0]

    def pose(self, depth_m: float, rng: np.random.Generator) -> NDArray[np.float64]:
        """Random pose near the axis: any sub-pixel position, tilted by up to 30 degrees."""
        axis = rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(0, MAX_TILT_RAD)
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(turn)[0]
        pose[:3, 3] = (*rng.uniform(-0.06, 0.06, 2) * depth_m, depth_m)
        return pose


def noise_row(rig: str, name: str, depth_m: float, draws: int) -> Row:
    """Row of the noise: sample standard deviation at a fixed pose."""
    eye, rng = Eye(rig, name), np.random.default_rng(1)
    pose = np.eye(4)
    pose[:3, 3] = (0.0103 * depth_m, 0.0207 * depth_m, depth_m)
    eye.drawing.draw(pose, rng)
    first = eye.detector.detect(eye.drawing.frame)
    points = []
    for _ in range(draws):
        eye.drawing.draw(pose, rng)
        if first is not None:
            seen = eye.detector.track(eye.drawing.frame, first)
            if seen is not None:
                points.append(seen.point_px)
    deviation = np.std(points, axis=0, ddof=1) if len(points) > 1 else np.full(2, np.nan)
    return {
        "rig": rig,
        "target": name,
        "depth_m": depth_m,
        "std_u_px": round(float(deviation[0]), 4),
        "std_v_px": round(float(deviation[1]), 4),
        "detected": round(len(points) / draws, 4),
    }


def bias_row(rig: str, name: str, depth_m: float, poses: int) -> Row:
    """Row of the bias: |detected - true| over random poses without noise."""
    eye, rng = Eye(rig, name), np.random.default_rng(2)
    errors = []
    for _ in range(poses):
        pose = eye.pose(depth_m, rng)
        eye.drawing.draw(pose)
        seen = eye.detector.detect(eye.drawing.frame)
        if seen is not None:
            errors.append(seen.point_px - eye.true_px(pose))
    vectors = np.array(errors)
    distance = np.linalg.norm(vectors, axis=1)
    return {
        "rig": rig,
        "target": name,
        "depth_m": depth_m,
        "mean_px": round(float(distance.mean()), 4),
        "rms_px": round(float(np.sqrt((distance**2).mean())), 4),
        "max_px": round(float(distance.max()), 4),
        "mean_u_px": round(float(vectors[:, 0].mean()), 4),
        "mean_v_px": round(float(vectors[:, 1].mean()), 4),
        "detected": round(len(errors) / poses, 4),
    }


def corner_row(rig: str, depth_m: float, poses: int) -> Row:
    """Row of errors of a tag's corners, centre, and depth by PnP, at random poses with noise."""
    eye, rng = Eye(rig, "tag"), np.random.default_rng(5)
    target = eye.drawing.target
    board = np.column_stack([target.corners_m, np.zeros(4)])
    corners, centres, sigmas, depths, smooth = [], [], [], [], []
    for _ in range(poses):
        pose = eye.pose(depth_m, rng)
        true = eye.camera.project(board @ pose[:3, :3].T + pose[:3, 3])
        eye.drawing.draw(pose)
        quiet = eye.detector.detect(eye.drawing.frame)
        if quiet is not None:
            smooth.append(quiet.corners_px - true)
        eye.drawing.draw(pose, rng)
        seen = eye.detector.detect(eye.drawing.frame)
        if seen is None:
            continue
        corners.append(seen.corners_px - true)
        sigmas.append(seen.corners_sigma_px)
        centres.append(seen.point_px - eye.true_px(pose))
        found, _turn, place = cv2.solvePnP(
            board, seen.corners_px, eye.camera.matrix, eye.camera.lens.coefficients
        )
        assert found
        depths.append(float(place[2, 0]) / depth_m - 1.0)
    edge = target.edge_m * eye.camera.focal[0] / depth_m
    return {
        "rig": rig,
        "depth_m": depth_m,
        "edge_px": round(edge, 1),
        "corner_rms_px": round(_rms(corners), 4),
        "said_sigma_px": round(_rms(sigmas), 4),
        "corner_bias_px": round(_rms(smooth), 4),
        "centre_rms_px": round(_rms(centres), 4),
        "depth_rms_percent": round(100 * _rms(depths), 4),
        "depth_mean_percent": round(100 * float(np.mean(depths)), 4),
        "detected": round(len(corners) / poses, 4),
    }


def light_row(rig: str, depth_m: float, light: str, poses: int) -> Row:
    """Row of a tag's errors with levels not proportional to light: clipped white, gamma."""
    eye, rng = Eye(rig, "tag"), np.random.default_rng(6)
    target, rendering = eye.drawing.target, eye.drawing.rendering
    board = np.column_stack([target.corners_m, np.zeros(4)])
    outwards, centres, sigmas, depths = [], [], [], []
    for _ in range(poses):
        pose = eye.pose(depth_m, rng)
        true = eye.camera.project(board @ pose[:3, :3].T + pose[:3, 3])
        eye.drawing.draw(pose, rng)
        share = eye.drawing.frame / 255.0
        kind, value = light.split()
        if kind == "white":  # times the greatest level
            share = np.minimum(share * float(value) * 255.0 / rendering.white_grey, 1.0)
        else:
            share = share ** float(value)
        seen = eye.detector.detect(np.rint(255.0 * share).astype(np.uint8))
        if seen is None:
            continue
        along = true - true.mean(axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        outwards.append(((seen.corners_px - true) * along).sum(axis=1))
        centres.append(seen.point_px - eye.true_px(pose))
        sigmas.append(seen.corners_sigma_px)
        _found, _turn, place = cv2.solvePnP(
            board, seen.corners_px, eye.camera.matrix, eye.camera.lens.coefficients
        )
        depths.append(float(place[2, 0]) / depth_m - 1.0)
    return {
        "rig": rig,
        "depth_m": depth_m,
        "edge_px": round(target.edge_m * eye.camera.focal[0] / depth_m, 1),
        "light": light,
        "corner_outwards_px": round(float(np.mean(outwards)), 3),
        "centre_rms_px": round(_rms(centres), 4),
        "said_sigma_px": round(_rms(sigmas), 4),
        "depth_mean_percent": round(100 * float(np.mean(depths)), 3),
        "detected": round(len(outwards) / poses, 3),
    }


def _rms(values: list) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def smear_row(rig: str, name: str, smear_px: float, draws: int) -> Row:
    """Row of motion blur: fraction of frames with the target at 1 m tracked, and worst error."""
    eye, rng = Eye(rig, name), np.random.default_rng(3)
    seen_count, worst = 0, 0.0
    for _ in range(draws):
        pose = eye.pose(1.0, rng)
        true = eye.true_px(pose)
        eye.drawing.draw(pose)
        still = eye.detector.detect(eye.drawing.frame)
        if still is None:
            continue
        angle = rng.uniform(0, 2 * np.pi)
        eye.drawing.draw(pose, rng, smear_px * np.array([np.cos(angle), np.sin(angle)]))
        seen = eye.detector.track(eye.drawing.frame, still)
        if seen is not None:
            seen_count += 1
            worst = max(worst, float(np.linalg.norm(seen.point_px - true)))
    return {
        "rig": rig,
        "target": name,
        "smear_px": smear_px,
        "detected": round(seen_count / draws, 3),
        "max_error_px": round(worst, 3),
    }


def cost_row(rig: str, name: str, depth_m: float, frames: int) -> Row:
    """Row of run times: drawing, tracking and full detection on one core, us, best of five."""
    eye, rng = Eye(rig, name), np.random.default_rng(4)
    pose = np.eye(4)
    pose[:3, 3] = (0.01 * depth_m, 0.02 * depth_m, depth_m)
    eye.drawing.draw(pose, rng)
    image = eye.drawing.frame
    first = eye.detector.detect(image)
    assert first is not None

    def best(call: Callable[[], object], count: int) -> float:
        times = []
        for _ in range(5):
            start = time.perf_counter()
            for _ in range(count):
                call()
            times.append((time.perf_counter() - start) / count)
        return round(1e6 * min(times), 1)

    return {
        "rig": rig,
        "target": name,
        "depth_m": depth_m,
        "draw_us": best(lambda: eye.drawing.draw(pose, rng), frames),
        "track_us": best(lambda: eye.detector.track(image, first), frames),
        "detect_us": best(lambda: eye.detector.detect(image), max(frames // 20, 2)),
    }


LIGHTS = ("white 0.95", "white 1.05", "white 1.2", "white 2.0", "gamma 0.4545")
"""Levels of white paper relative to the camera's saturation, and an approximate sRGB exponent."""


def show(title: str, rows: list[Row]) -> None:
    """Print rows as a Markdown table."""
    print(f"\n{title}\n\n| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(str(value) for value in row.values()) + " |")


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="file to write the tables to")
    parser.add_argument("--draws", type=int, default=1200, help="noise draws a depth")
    parser.add_argument("--poses", type=int, default=300, help="random poses a depth")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    cases = [(rig, name) for rig in RIGS for name in TARGETS]
    tables = {
        "noise": [noise_row(*c, z, arguments.draws) for c in cases for z in DEPTHS_M],
        "corners": [corner_row(rig, z, arguments.poses) for rig in RIGS for z in CORNER_DEPTHS_M],
        "bias": [bias_row(*c, z, arguments.poses) for c in cases for z in DEPTHS_M],
        "smear": [
            smear_row(*c, smear, arguments.poses // 3)
            for c in cases
            for smear in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0)
        ],
        "light": [
            light_row(rig, z, light, arguments.poses // 10)
            for rig in RIGS
            for z in (0.5, 1.0, 2.0)
            for light in LIGHTS
        ],
        "cost": [cost_row(*c, z, 100) for c in cases for z in (0.5, 1.0, 2.5)],
    }
    for title, rows in tables.items():
        show(title, rows)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(tables, indent=1) + "\n")


if __name__ == "__main__":
    main()

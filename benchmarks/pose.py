"""Measure errors, ambiguity and run time of the poses of tags and boards.

Run ``python -m benchmarks.pose``, with ``--count`` to draw more images. With a folder of
photographs of a board by a calibrated pair (``left1.jpg``, ``right1.jpg`` and so on) and its
``--head``, the poses by its two eyes are compared instead.

The normalised error is d^T C^-1 d / 6, with d the error of the pose and C its covariance: 1 in the
mean if C holds. Of two solutions the nearer one counts.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence import Noise, load_head
from vergence.perception.locate import locate
from vergence.vision import AprilTag, Camera, Checkerboard, TargetRenderer, make_detector
from vergence.vision.detection import corner_noise
from vergence.vision.pose import Pose, View, estimate_pose, eye_views

TARGETS = {"tag": AprilTag(), "board": Checkerboard(columns=9, rows=6, square_m=0.02)}
RIGS = ("simulated", "physical")
EXTENTS_PX = {"tag": (30.0, 120.0), "board": (80.0, 240.0)}
Matrix = NDArray[np.float64]


def drawn_pose(rng: np.random.Generator, depth_m: float, tilts_rad: tuple[float, float]) -> Matrix:
    """Random pose near the axis, with a tilt of random direction and any roll."""
    direction, roll = rng.uniform(-np.pi, np.pi, 2)
    tilt = rng.uniform(*tilts_rad) * np.array([np.cos(direction), np.sin(direction), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    pose[:3, 3] = depth_m * np.array([*rng.uniform(-0.12, 0.12, 2), 1.0])
    return pose


def nearest(found: Pose | None, pose: Matrix) -> tuple[Matrix, Pose]:
    """(6,) translation and rotation vector to a pose from the solution of nearer tilt; and that."""
    assert found is not None
    each = [one for one in (found, found.other) if one is not None]
    turns = [np.asarray(cv2.Rodrigues(pose[:3, :3] @ one.matrix[:3, :3].T)[0]) for one in each]
    k = int(np.argmin([np.linalg.norm(turn) for turn in turns]))
    return np.concatenate([pose[:3, 3] - each[k].matrix[:3, 3], turns[k].ravel()]), each[k]


def normalised(apart: Matrix, covariance: Matrix) -> float:
    """Normalised squared error."""
    return float(apart @ np.linalg.solve(covariance, apart)) / 6.0


def opencv_difference(target: Any, camera: Camera, pixels: Matrix) -> float:
    """Relative distance to solvePnPGeneric and solvePnPRefineLM, for equal sigmas."""
    ours = estimate_pose(target.corners_m, [View(camera, pixels, np.ones(pixels.shape))])
    given = np.pad(target.corners_m, ((0, 0), (0, 1))), pixels, camera.matrix, None
    _, turns, places, _ = cv2.solvePnPGeneric(*given, flags=cv2.SOLVEPNP_IPPE)
    ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-14)
    w, t = cv2.solvePnPRefineLM(*given, turns[0], places[0], criteria=ends)
    theirs = np.block([[cv2.Rodrigues(w)[0], t], [np.eye(4)[3:]]])
    return float(np.abs(nearest(ours, theirs)[1].matrix - theirs).max() / t[2, 0])


def measure_drawn(count: int) -> None:
    """Print normalised errors in drawn images with errors of the joints, and times of the poses."""
    errors, times_ms = defaultdict(list), defaultdict(list)
    from_opencv, lost = [], 0
    for rig, (name, target) in [(rig, one) for rig in RIGS for one in TARGETS.items()]:
        head, rng = load_head(rig), np.random.default_rng(8)
        joint_rad, cameras = Noise.of(head).joint_rad, [Camera.of(head, eye) for eye in range(2)]
        drawings = [TargetRenderer(camera, target, head.rendering) for camera in cameras]
        detectors = [make_detector(target, camera) for camera in cameras]
        for _ in range(count // 4):
            extent_px = np.exp(rng.uniform(*np.log(EXTENTS_PX[name])))
            depth_m = np.ptp(target.corners_m, axis=0).max() * cameras[0].focal[0] / extent_px
            T_N_T = drawn_pose(rng, depth_m, (0.26, 0.87))
            q = head.fixate(T_N_T[:3, 3], warn=False)
            off = rng.normal(0.0, joint_rad) * (np.arange(7) >= 3)
            true_q = head.actuation.joints_of(head.actuation.actuators_of(q) + off)
            T_C_T, seen = np.linalg.inv(head.camera_poses(true_q)) @ T_N_T, []
            for drawing, detector, pose in zip(drawings, detectors, T_C_T, strict=True):
                drawing.draw(pose, rng)
                seen.append(detector.detect(drawing.frame))
            found = [one for one in seen if one is not None]
            lost += len(found) < 2
            if len(found) < 2:
                continue
            corners, noise = [d.corners_px for d in found], [corner_noise(d) for d in found]
            views = eye_views(head, q, corners, noise, joint_rad)
            for eyes, truth in (("one eye", T_C_T[0]), ("both eyes", T_N_T)):
                start = time.thread_time()
                alone = eyes == "one eye"
                pose = found[0].pose if alone else estimate_pose(target.corners_m, views)
                times_ms[f"{name}, {eyes}"].append(1e3 * (time.thread_time() - start))
                apart, used = nearest(pose, truth)
                told = pose is not None and pose.other is not None
                for key in (f"{rig} {name}", "total"):
                    errors[f"{key}, {eyes}"].append((normalised(apart, used.covariance), told))
            if not cameras[0].distorts:
                from_opencv.append(opencv_difference(target, cameras[0], corners[0]))
    print(f"normalised squared error, and two solutions ({lost} targets not found)")
    for key, values in errors.items():
        error, told = np.mean(values, axis=0)
        print(f"  {key}: {error:.2f}, {100 * told:.1f} % of {len(values)}")
    print(f"largest difference from OpenCV, over the distance: {max(from_opencv):.1e}")
    for key, spent in times_ms.items():
        print(f"processor time of a pose, {key}: median {np.median(spent):.2f} ms")


def measure_ambiguity(count: int) -> None:
    """Print how often a tag's second solution is named, by D, its chi-square without noise."""
    camera, target = Camera.of(load_head("simulated"), 0), TARGETS["tag"]
    rng, rows = np.random.default_rng(7), []
    for _ in range(count):
        T = drawn_pose(rng, rng.uniform(0.9, 5.0), (0.1, 0.8))
        exact = camera.project(np.pad(target.corners_m, ((0, 0), (0, 1))) @ T[:3, :3].T + T[:3, 3])
        sigma = np.full((4, 2), np.exp(rng.uniform(-3.5, -1.2)))
        noisy = exact + sigma * rng.normal(size=(4, 2))
        found = estimate_pose(target.corners_m, [View(camera, noisy, sigma)])
        # with a sigma of 100 times as much, both solutions are named
        both = estimate_pose(target.corners_m, [View(camera, exact, 100.0 * sigma)])
        if both is not None and both.other is not None and found is not None:
            wrong = nearest(both, found.matrix)[1] is both.other
            D = 1e4 * (both.other.chi_square - both.chi_square)
            rows.append((found.other is not None, D < 4.0, D > 60.0, wrong))
    named, *cases = np.array(rows, bool).T
    for what, those in zip(("both fit", "one fits", "the best is wrong"), cases, strict=True):
        print(f"a second one where {what}: {100 * named[those].mean():.1f} % of {those.sum()}")


def compare_eyes(folder: Path, head: str, target: str) -> None:
    """Print the differences between the poses by the left and the right eye of a pair."""
    model, rows = load_head(head), []
    left, right = model.camera_poses(model.rest())
    T_L_R = np.linalg.inv(left) @ right
    turn = np.kron(np.eye(2), T_L_R[:3, :3])
    for one in locate(folder, folder, head, [target]).located:
        of_left, of_right = one.eye_poses
        assert of_right is not None
        apart, of_left = nearest(of_left, T_L_R @ of_right.matrix)
        covariance = of_left.covariance + turn @ of_right.covariance @ turn.T
        length, angle = np.linalg.norm(apart.reshape(2, 3), axis=1)
        spread = of_left.chi_square / of_left.degrees
        rows.append((normalised(apart, covariance), spread, 1e3 * length, np.degrees(angle)))
    print(f"{len(rows)} pairs, medians: normalised squared difference, chi^2 / degrees, mm, deg")
    print(*np.round(np.median(rows, axis=0), 2))


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pose")
    parser.add_argument("folder", type=Path, nargs="?", help="photographs of a pair")
    parser.add_argument("--head", help="its head file")
    parser.add_argument("--target", default="checkerboard:9x6:24.23")
    parser.add_argument("--count", type=int, default=500, help="drawn targets")
    given = parser.parse_args()
    if given.folder is None:
        measure_drawn(given.count)
        measure_ambiguity(2 * given.count)
    elif given.head is None:
        parser.error("expected --head beside the folder")
    else:
        compare_eyes(given.folder, given.head, given.target)


if __name__ == "__main__":
    main()

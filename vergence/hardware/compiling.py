"""Compilation of every function that a robot's control loop calls, before torque goes on."""

from contextlib import suppress
from typing import Final

import cv2
import numpy as np

from vergence.envs.plants.cameras import BoardImageRenderer
from vergence.errors import PointRefusedError
from vergence.hardware.common_time import pixels_at_common_time
from vergence.models.camera import Camera
from vergence.models.head import HeadModel
from vergence.vision.objects.search import HeadSearch
from vergence.vision.objects.targets import GazeTarget, ObjectTarget, OwnTarget, PointTarget
from vergence.vision.targets import PlanarTarget, TagFamily
from vergence.vision.tracking import Tracker, make_detector

_CELL_PX: Final = 8.0
"""Cell size of the board that is drawn for the compilation, px (chosen)."""


def compile_loop_kernels(head: HeadModel, target: GazeTarget) -> None:
    """Call every kernel of the loop once, on images with the target and on one without.

    Args:
        head: the model of the head.
        target: the target that the cameras detect.
    """
    q, still = head.rest(), np.zeros(7)
    pixels_at_common_time(head, head.cameras.principal, np.stack([q, q]), q)
    if not isinstance(target, PlanarTarget | TagFamily):
        if not isinstance(target, OwnTarget):  # which runs in a process of its own
            _search_once(head, target)
        return
    board = target.tag(0) if isinstance(target, TagFamily) else target
    views = BoardImageRenderer(head, board)
    poses = head.base_pose(q) @ head.camera_poses(q)
    for eye, T_N_C in enumerate(head.camera_poses(q)):
        away_m = float(head.cameras.focal[eye].mean()) * board.cell_m / _CELL_PX
        point = T_N_C[:3, 3] + away_m * T_N_C[:3, 2]
        tracker = Tracker(make_detector(target, Camera.of(head, eye)))
        image = views.draw(q, still, point)[eye].copy()
        for seen in (image, image, np.full_like(image, image[0, 0])):
            tracker.find(seen, T_0_C=poses[eye])


def _search_once(head: HeadModel, target: ObjectTarget) -> None:
    """Call an object's detector on images of noise, and track in them."""
    q = head.rest()
    poses = head.base_pose(q) @ head.camera_poses(q)
    if isinstance(target, PointTarget):
        u, v = head.cameras.principal[0].tolist()
        target = PointTarget(eye=0, pixel=(u, v))
    search, rng = HeadSearch(target, head), np.random.default_rng(0)
    levels = rng.integers(256, size=(60, 80, 3), dtype=np.uint8)
    for time_s in (0.0, 0.1):
        for eye, (width, height) in enumerate(head.cameras.size.tolist()):
            image = np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_CUBIC))
            with suppress(PointRefusedError):  # of noise, which is not what will be followed
                search.eyes[eye].look(image, poses[eye], time_s)
            search.eyes[eye].found()

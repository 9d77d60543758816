"""Hint at targets that are similar to the ones asked for: another number, another size."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.errors import ConfigurationError
from vergence.models.camera import camera_matrix
from vergence.perception.unseen_rows import UnseenRowCheck, rows_seen_and_in_view
from vergence.vision import Camera, make_detector
from vergence.vision.boards.april_layout import alternative_grids
from vergence.vision.boards.charuco import find_markers
from vergence.vision.boards.charuco_layout import alternative_charuco
from vergence.vision.detection import Detection
from vergence.vision.tag_families import AprilGrid
from vergence.vision.tags.library import families_in
from vergence.vision.targets import AprilTag, CharucoBoard, Checkerboard, TagFamily, Target

_SIZE_OFFSETS: Final = ((-1, -1), (-1, 0), (0, -1), (1, 0), (0, 1), (1, 1), (-2, -2))
"""Columns and rows to add to the size asked for; first the error of counting squares instead of
inner corners (chosen: likely mistakes against time)."""
_MARKER_COUNTS: Final = (50, 100, 250, 1000)
"""Sizes of OpenCV's dictionaries of one name; smaller ones begin larger ones (physical: OpenCV)."""
_MARKERS: Final = (
    *(f"DICT_{bits}X{bits}_1000" for bits in range(4, 8)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    "DICT_APRILTAG_36h11",
)
"""Dictionaries of markers that are tried (chosen: those in use)."""
_LEAST_MARKERS: Final = 4
"""Least markers that show a board, and least missing first ids that show that its ids begin later
(chosen: boards against clutter and hidden markers)."""
_MAX_NAMED_TARGETS: Final = 5
"""Most targets that a hint names (chosen: completeness against length)."""
_MAX_IMAGE_SIDE_PX: Final = 1280
"""Longest side of the image that is searched, px; larger images are reduced (chosen: small targets
against the time of a dozen searches in 12 megapixels)."""


def describe_similar_targets(
    image: NDArray[np.uint8], requested: Sequence[Target], camera: Camera | None = None
) -> str:
    """Phrase such as ``tag:36h11:3 is there`` on targets like those that were missed; or empty."""
    image, camera = _reduced(image, camera)
    if changed := _changed(image, requested, camera):
        return changed
    there: list[str] = []
    if any(isinstance(target, AprilTag | TagFamily) for target in requested):
        asked = [target.family for target in requested if isinstance(target, AprilTag)]
        there += (
            _tags(image, asked, camera)
            or _grids(image, None, camera)
            or _tags(image, families_in(image), camera)
        )
    for target in requested:
        if isinstance(target, Checkerboard):
            there += _boards(image, target, camera)
        elif isinstance(target, CharucoBoard):
            there += _charuco(image, target, camera)
        elif isinstance(target, AprilGrid):
            there += _grids(image, target, camera) or _single_border(image, camera)
    there = list(dict.fromkeys(there))
    if not there:
        return ""
    more = f" and {len(there) - _MAX_NAMED_TARGETS} more" if len(there) > _MAX_NAMED_TARGETS else ""
    verb = "is" if len(there) == 1 else "are"
    return f"{', '.join(there[:_MAX_NAMED_TARGETS])}{more} {verb} there"


def _reduced(
    image: NDArray[np.uint8], camera: Camera | None
) -> tuple[NDArray[np.uint8], Camera | None]:
    """Reduce a large image to a size that is searched quickly, and its camera accordingly."""
    height, width = image.shape
    if max(width, height) <= _MAX_IMAGE_SIDE_PX:
        return image, camera
    scale = _MAX_IMAGE_SIDE_PX / max(width, height)
    size = round(scale * width), round(scale * height)
    if camera is not None:
        u, v = size[0] / width, size[1] / height
        camera = replace(
            camera,
            size=size,
            matrix=camera_matrix(camera.focal * (u, v), (camera.principal + 0.5) * (u, v) - 0.5),
        )
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), camera


def _tags(image: NDArray[np.uint8], families: Sequence[str], camera: Camera | None) -> list[str]:
    """Tags of the first family that has any."""
    for family in dict.fromkeys(families):
        found = make_detector(TagFamily(family=family, size_known=False), camera).detect_all(image)
        if found:
            return [str(each.target) for each in found]
    return []


def _boards(image: NDArray[np.uint8], target: Checkerboard, camera: Camera | None) -> list[str]:
    """First board of similar size."""
    for columns, rows in _SIZE_OFFSETS:
        try:
            other = replace(target, columns=target.columns + columns, rows=target.rows + rows)
        except ConfigurationError:  # too few corners for a board
            continue
        if make_detector(other, camera).search(image) is not None:
            return [f"{other} (inner corners)"]
    return []


def _grids(image: NDArray[np.uint8], target: AprilGrid | None, camera: Camera | None) -> list[str]:
    """Grid with other counts or another spacing; any grid if no target is given."""
    for other in alternative_grids(image, target):
        found = make_detector(other, camera).detect(image)
        if found is not None:
            other = _without_unseen_rows(found, image)
            size = "" if target is None else f"{1000 * target.tag_m:g}"
            name = f"aprilgrid:{other.columns}x{other.rows}:{size or 'TAG'}:{other.spacing:g}"
            return [f"{name} (tags, and their gap by their edge)"]
    return []


def _without_unseen_rows(found: Detection, image: NDArray[np.uint8]) -> Any:
    """The target found, or the board of fewer rows that fits the image better."""
    check = UnseenRowCheck()
    check.add(found, image.shape)
    return check.fitting_boards().get(found.target, found.target)


def _single_border(image: NDArray[np.uint8], camera: Camera | None) -> list[str]:
    """Tags as the AprilTag library prints them, or of another family."""
    found = _tags(image, families_in(image), camera)
    return [f"{each} (a single tag, its border one bit wide)" for each in found[:1]]


def _charuco(image: NDArray[np.uint8], target: CharucoBoard, camera: Camera | None) -> list[str]:
    """Board with other counts or another dictionary; if it is none of these, its markers' ids."""
    for dictionary in dict.fromkeys([target.dictionary, *_MARKERS]):
        corners, seen = find_markers(
            image, cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        )
        if len(seen) >= _LEAST_MARKERS:
            break
    else:
        return []
    name, size = dictionary.rsplit("_", 1)
    if dictionary != target.dictionary and size == "1000":  # smaller ones begin with its markers
        dictionary = f"{name}_{min(n for n in _MARKER_COUNTS if n > max(seen))}"
    other = alternative_charuco(corners, seen, target, dictionary)
    found = None if other in (None, target) else make_detector(other, camera).search(image)
    if found is not None:
        there, in_view = rows_seen_and_in_view(found, image.shape)
        if not in_view[: np.flatnonzero(there)[0]].any():  # else its ids begin later
            return [str(_without_unseen_rows(found, image))]
    own = dictionary.removeprefix("DICT_")
    if min(seen) >= _LEAST_MARKERS and max(seen) - min(seen) < 2 * len(seen):
        return [f"a board of {own} whose ids begin at {min(seen)} in place of 0"]
    return [] if dictionary == target.dictionary else [f"a board of {own}"]


def _changed(image: NDArray[np.uint8], requested: Sequence[Target], camera: Camera | None) -> str:
    """A requested target that the mirrored image or its negative shows; empty if there is none."""
    for name, other in (
        ("mirrored", np.ascontiguousarray(image[:, ::-1])),
        ("white on black", 255 - image),
    ):
        for target in requested:
            if isinstance(target, Checkerboard):  # looks alike mirrored or as a negative
                continue
            found = make_detector(target, camera).detect(other)
            if found is not None:
                return f"{found.target} is there, {name}"
    return ""

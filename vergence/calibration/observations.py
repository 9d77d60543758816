"""Detected corners of a board in photographs, view by view, with standard deviations."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import BundleAdjustment
from vergence.errors import ConfigurationError
from vergence.models.camera import CameraResponse
from vergence.models.parts import FloatArray
from vergence.perception.finding import PhotographSearch, TargetFinder
from vergence.perception.notes import LinearResponseCheck, describe_similar_targets
from vergence.perception.photographs import join_first_names
from vergence.vision import BoardDetection, parse_target, read_image
from vergence.vision.targets import AprilTag, PlanarTarget, TagFamily

_MISSES_BEFORE_CHECK: Final = 6
"""Photographs without the board after which another board is searched for (chosen: an early
message against a wrong one)."""
_LARGE_IMAGE_PX: Final = 1600
"""Longer side above which an image is searched again at half its size, px (chosen: larger images
are often soft from pixel to pixel)."""
LEAST_CORNERS: Final = 6
"""Fewest corners of a view (chosen: fewer hardly determine more than the view's pose)."""

_ALIKE_SIGMAS: Final = 3.0
"""Median distance of two views' corners, in its standard deviations, up to which the views are
alike (chosen: board and cameras at rest leave 0.2 to 1, and public sets' nearest poses 7)."""


def parse_board(text: str, *, accept_single_tag: bool = False) -> PlanarTarget:
    """Parse the name of a board, or, if accepted, of a tag, too few corners for a camera."""
    target = parse_target(text)
    if accept_single_tag and isinstance(target, TagFamily):
        raise ConfigurationError(
            "target: expected one tag, with its number and its edge in mm, such as "
            f"tag:36h11:0:120, got {text}"
        )
    if isinstance(target, TagFamily) or (isinstance(target, AprilTag) and not accept_single_tag):
        raise ConfigurationError(
            "target: expected a board with many corners, such as checkerboard:9x6:24 (inner "
            f"corners, square in mm), got {text}"
        )
    return target


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardObservations:
    """The corners of a board in the photographs of one camera or of two."""

    target: PlanarTarget
    file_names: tuple[tuple[str, ...], ...]
    """(c, v) file of each photograph."""
    image_sizes: tuple[tuple[int, int], ...]
    """(c) width and height of each camera's images, px."""
    pixels: FloatArray
    """(c, v, n, 2) corners, px; nan for those that were not found."""
    sigma: FloatArray
    """(c, v, n, 2) their standard deviations, px."""
    excluded: Mapping[str, str] = field(default_factory=dict)
    """Files of `file_names` that count as without the board, with the reason."""
    remarks: tuple[str, ...] = ()
    """Remarks on the images, a line each."""
    alike_count: int = 0
    """Views of `excluded` that show what another view shows, see `alike_views`."""

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """(c, v) True for photographs in which enough of the board was found."""
        count = np.isfinite(self.pixels).all(axis=-1).sum(axis=-1)
        # a tag, which some callers accept, has fewer corners
        return np.asarray(count >= min(LEAST_CORNERS, self.pixels.shape[2]))

    @cached_property
    def problem(self) -> BundleAdjustment:
        """The bundle adjustment of all views; unusable photographs count as without corners."""
        corners = self.target.corners_m
        blank = ~self.usable[..., None, None]
        return BundleAdjustment(
            np.column_stack([corners, np.zeros(len(corners))]),
            np.where(blank, np.nan, self.pixels),
            np.where(blank, np.nan, self.sigma),
        )

    def select_camera(self, camera: int) -> "BoardObservations":
        """Select the observations of one camera."""
        only = slice(camera, camera + 1)
        return replace(
            self, file_names=self.file_names[only], image_sizes=self.image_sizes[only],
            pixels=self.pixels[only], sigma=self.sigma[only],
        )  # fmt: skip

    def select(self, views: NDArray[np.bool_]) -> "BoardObservations":
        """Select the observations of some views."""
        return replace(
            self,
            file_names=tuple(
                tuple(name for name, there in zip(names, views, strict=True) if there)
                for names in self.file_names
            ),
            pixels=self.pixels[:, views],
            sigma=self.sigma[:, views],
        )

    def without_alike_views(self) -> "BoardObservations":
        """Exclude all but one of alike views, which tell as much as one, and remark on it."""
        alike = alike_views(self.pixels, self.sigma)
        if not alike:
            return self
        pixels, excluded = self.pixels.copy(), dict(self.excluded)
        pixels[:, list(alike)] = np.nan
        for view, other in alike.items():
            why = f"like {Path(self.file_names[0][other]).name} but for noise"
            excluded |= {names[view]: why for names in self.file_names}
        remark = (
            f"{len(alike)} of {len(self.file_names[0])} views are like others but for noise, and "
            "count as one with them: move the board between photographs."
        )
        return replace(
            self, pixels=pixels, excluded=excluded, remarks=(remark, *self.remarks),
            alike_count=len(alike),
        )  # fmt: skip

    def without_corners(self, away_px: FloatArray) -> "BoardObservations":
        """Leave out mistaken corners, (c, v, n) px away, 0 for good ones, and remark on them."""
        said = join_first_names(
            f"{Path(self.file_names[camera][view]).name} ({away_px[camera, view].max():.1f} px)"
            for camera, view in np.argwhere(away_px.any(axis=-1)).tolist()
        )
        count = np.count_nonzero(away_px)
        remark = (
            f"{count} corner{'' if count == 1 else 's'} left out, far from where the others of the "
            f"view put {'it' if count == 1 else 'them'}: {said}"
        )
        pixels = np.where((away_px > 0.0)[..., None], np.nan, self.pixels)
        return replace(self, pixels=pixels, remarks=(remark, *self.remarks))

    @property
    def digest(self) -> str:
        """SHA-256 over the board and its corners, rounded to 1e-6 px."""
        content = np.concatenate([self.pixels.ravel(), self.sigma.ravel()])
        sha = hashlib.sha256(str(self.target).encode())
        sha.update(np.round(np.nan_to_num(content, nan=-1.0), 6).astype("<f8").tobytes())
        return sha.hexdigest()


class _BoardFinder(TargetFinder):
    """Finds a board, tried also at half sizes, as large images are soft."""

    def __init__(
        self, target: PlanarTarget, response: CameraResponse | None, check: LinearResponseCheck
    ) -> None:
        super().__init__([target], response=response)
        self.response_check = check  # one of all cameras

    def find(self, image: NDArray[Any]) -> list[BoardDetection]:
        scale, (detector,) = 1.0, self._detectors
        found = detector.detect(image)
        if image.dtype == np.int32:  # from a TIFF; cv2.resize does not take it
            image = image.astype(np.float32)
        while found is None and max(image.shape[:2]) > _LARGE_IMAGE_PX:
            image = np.asarray(
                cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            )
            scale *= 2.0
            found = detector.detect(image)
        if found is None:
            return []
        self.response_check.add(image, [found], detector.response_of(image))
        corners = scale * (found.corners_px + 0.5) - 0.5  # pixel centres are at integers
        sigma = scale * found.corners_sigma_px
        return [found._replace(corners_px=corners, corners_sigma_px=sigma)]


def detect_board_corners(
    target: PlanarTarget,
    photographs: Sequence[Sequence[Path]],
    progress: Callable[[float], None] | None = None,
    responses: Sequence[CameraResponse | None] | None = None,
) -> tuple[BoardObservations, list[str]]:
    """Find a board in (c, v) photographs; also a line for each file that could not be read."""
    every = [path for files in photographs for path in files]
    check = LinearResponseCheck()
    finders = [
        _BoardFinder(target, response, check)
        for response in (responses or [None] * len(photographs))
    ]
    views = [
        [(finder, path)]
        for finder, files in zip(finders, photographs, strict=True)
        for path in files
    ]
    pixels = np.full((len(photographs), len(photographs[0]), len(target.corners_m), 2), np.nan)
    sigma = pixels.copy()
    sizes: dict[Path, tuple[int, int]] = {}
    search = PhotographSearch([target], views, check_white=False)
    for number, (found, place) in enumerate(
        zip(search.search(progress), np.ndindex(pixels.shape[:2]), strict=True), 1
    ):
        for path, image, detections in found:
            sizes[path] = (image.shape[1], image.shape[0])
            for one in detections:
                pixels[place], sigma[place] = one.corners_px, one.corners_sigma_px
        if number == _MISSES_BEFORE_CHECK and not np.isfinite(pixels).any():
            _refuse_another(target, every[:number], sizes)
    observations = BoardObservations(
        target=target,
        file_names=tuple(tuple(map(str, files)) for files in photographs),
        image_sizes=tuple(_one_size(files, sizes) for files in photographs),
        pixels=pixels,
        sigma=sigma,
        excluded={str(path): "it could not be read" for path in every if path not in sizes},
        remarks=search.remarks(every),
    )
    seen = np.isfinite(pixels)
    if len(pixels) > 1 and seen.any() and np.array_equal(pixels[0], pixels[1], equal_nan=True):
        raise ConfigurationError(
            "expected photographs of two cameras, got the same ones for the left and the right"
        )
    for camera, files in enumerate(photographs):
        if not observations.usable[camera].any():
            if not seen[camera].any():
                _refuse_another(target, files, sizes)
            raise _not_found(target, files, "")
    return observations, search.failures


def alike_views(pixels: FloatArray, sigma: FloatArray) -> dict[int, int]:
    """View to keep, the fullest, by each that is like it but for noise; (c, v, n, 2) px or nan."""
    counts = np.isfinite(pixels).all(axis=-1).sum(axis=(0, 2))
    kept: list[int] = []
    alike = {}
    for view in np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)].tolist():
        variances = sigma[:, kept] ** 2 + sigma[:, [view]] ** 2
        squares = ((pixels[:, kept] - pixels[:, [view]]) ** 2 / variances).mean(axis=-1)
        both = np.isfinite(squares)
        near = (squares < _ALIKE_SIGMAS**2).sum(axis=-1) > 0.5 * both.sum(axis=-1)
        common = both.sum(axis=-1) >= min(LEAST_CORNERS, pixels.shape[2])
        same = common.any(axis=0) & (near | ~common).all(axis=0)
        if same.any():
            alike[view] = kept[int(same.argmax())]
        else:
            kept.append(view)
    return dict(sorted(alike.items()))


def _refuse_another(
    target: PlanarTarget, files: Sequence[Path], sizes: Mapping[Path, tuple[int, int]]
) -> None:
    """Refuse photographs of another board, of which those with a size could be read."""
    readable = [path for path in files if path in sizes]
    there = describe_similar_targets(read_image(readable[0]), [target]) if readable else ""
    if there:
        raise _not_found(target, files, f"; in {readable[0].name} {there}")


def _not_found(target: PlanarTarget, files: Sequence[Path], hint: str) -> ConfigurationError:
    return ConfigurationError(
        f"expected {target} in {files[0].parent} "
        f"({join_first_names(path.name for path in files)}), found in none of {len(files)} "
        f"images{hint}"
    )


def _one_size(files: Sequence[Path], sizes: Mapping[Path, tuple[int, int]]) -> tuple[int, int]:
    """Get the common size of a camera's images, px."""
    by_size: dict[tuple[int, int], list[str]] = {}
    for path in files:
        if path in sizes:
            by_size.setdefault(sizes[path], []).append(path.name)
    if not by_size:
        raise ConfigurationError(f"expected images that can be read, got none like {files[0]}")
    ordered = sorted(by_size.items(), key=lambda item: -len(item[1]))
    if len(ordered) > 1:
        (size, _), (other, names) = ordered[0], ordered[1]
        raise ConfigurationError(
            f"expected images of one size, since a calibration is for one size, got {size[0]} x "
            f"{size[1]} "
            f"px in most and {other[0]} x {other[1]} in {join_first_names(names)}"
        )
    return ordered[0][0]

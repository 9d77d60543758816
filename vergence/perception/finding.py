"""Find all targets that are asked for in photographs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import CameraResponse
from vergence.models.head_file import load_head
from vergence.models.parts import EYE_NAMES, FloatArray
from vergence.models.stereo_files import read_intrinsics
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.perception.notes import LinearResponseCheck, PhotographNotes, target_key
from vergence.perception.photographs import list_photographs
from vergence.vision import Camera, as_grey, make_detector, parse_target
from vergence.vision.detection import Detection
from vergence.vision.image import read_pixels
from vergence.vision.pose import Pose
from vergence.vision.targets import AprilTag, PlanarTarget, Target


class Photograph(NamedTuple):
    """An image and the targets found in it."""

    path: Path
    image: NDArray[np.uint8]
    """(height, width) grey levels."""
    detections: list[Detection]


def parse_targets(texts: Sequence[str]) -> list[Target]:
    """Parse targets from texts, see `vergence.vision.parse_target`."""
    if not texts:
        raise ConfigurationError(
            "target: expected at least one, such as --target tag:36h11:5:120 or "
            "--target checkerboard:9x6:24.23, got none"
        )
    return [parse_target(text) for text in dict.fromkeys(texts)]


def tag_number(target: PlanarTarget) -> int | None:
    """The number of a tag; None for a board."""
    return target.id if isinstance(target, AprilTag) else None


class TargetFinder:
    """Finds all targets in images of one eye, each tag for the first that it matches."""

    def __init__(
        self,
        targets: Sequence[Target],
        camera: Camera | None = None,
        response: CameraResponse | None = None,
    ) -> None:
        self.response_check = LinearResponseCheck()
        self._detectors = [make_detector(target, camera, response) for target in targets]

    def find(self, image: ArrayLike) -> list[Detection]:
        """Find all targets, in the order of the targets given, tags sorted by their numbers."""
        found: list[Detection] = []
        for detector in self._detectors:
            known = {target_key(one.target) for one in found}
            new = [d for d in detector.detect_all(image) if target_key(d.target) not in known]
            self.response_check.add(image, new, detector.response_of(image))
            found += sorted(new, key=lambda one: tag_number(one.target) or 0)
        return found

    def find_in_file(self, path: Path) -> Photograph:
        """Read an image and find all targets in it."""
        pixels = read_pixels(path)
        try:
            return Photograph(path, as_grey(pixels), self.find(pixels))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error


class PhotographSearch:
    """Search of photographs of one camera, or of pairs of photographs of two, for targets."""

    def __init__(
        self,
        targets: Sequence[Target],
        cameras: Sequence[Camera | None],
        response: CameraResponse | None = None,
    ) -> None:
        self.finders = [TargetFinder(targets, camera, response) for camera in cameras]
        self.failures: list[str] = []
        """Images that could not be read, one line each."""
        self._notes = PhotographNotes(targets)

    def search(
        self,
        views: Sequence[Sequence[Path]],
        progress: Callable[[float], None] | None,
        *,
        is_single: bool,
        kind: str = "",
    ) -> Iterator[list[Photograph]]:
        """The photographs of each view that can be read; of a single one, a failure is raised."""
        for number, paths in enumerate(views, 1):
            try:
                found = [f.find_in_file(path) for f, path in zip(self.finders, paths, strict=True)]
            except VergenceError as error:
                if is_single:
                    raise
                self.failures.append(str(error))
                continue
            for photograph in found:
                self._notes.add(photograph.image, photograph.detections)
            yield found
            if progress is not None:
                progress(number / len(views))
        if len(self.failures) == len(views):
            raise ConfigurationError(
                f"expected images that can be read, got none in {len(views)}{kind}; the first: "
                f"{self.failures[0]}"
            )

    def remarks(self, paths: Sequence[Path]) -> tuple[str, ...]:
        """Notes on the images searched, and on the orientation of some files."""
        return self._notes.lines(paths, [finder.response_check for finder in self.finders])


class Sighting(NamedTuple):
    """A target in an image."""

    image: str
    """The image's path as it was given."""
    detection: Detection
    centre_px: FloatArray
    """(2,) its centre; nan where too few corners of a board were found."""
    sigma_px: FloatArray
    """(2,) standard deviation of the centre."""

    def document(self) -> dict[str, Any]:
        """Plain values, pixels; None for values that are nan."""
        target, found = self.detection.target, self.detection
        return {
            "image": self.image,
            "target": str(target),
            "id": tag_number(target),
            "centre_px": null_nonfinite_rows(self.centre_px),
            "corners_px": null_nonfinite_rows(found.corners_px),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "corners_sigma_px": null_nonfinite_rows(found.corners_sigma_px),
            "pose": None if found.camera is None else pose_document(found.pose, target.size_known),
        }


def pose_document(pose: Pose | None, size_known: bool = True) -> dict[str, Any] | None:
    """Plain values, millimetres and radians; lengths are None if they hold only up to a factor."""
    if pose is None:
        return None
    unit = np.array([1e3 if size_known else np.nan] * 3 + [1.0] * 3)
    sigma = null_nonfinite_elements(unit * pose.sigma)
    return {
        "translation_mm": null_nonfinite_rows(unit[:3] * pose.matrix[:3, 3]),
        "rotation_vector_rad": pose.rotation_vector.tolist(),
        "rotation_matrix": pose.matrix[:3, :3].tolist(),
        "sigma_mm": sigma[:3] if size_known else None,
        "sigma_rad": sigma[3:],
        "covariance_mm_rad": null_nonfinite_elements(unit * pose.covariance * unit[:, None]),
        "chi_square": pose.chi_square,
        "degrees_of_freedom": pose.degrees,
        "size_ratio": pose.size_ratio,
        "other": pose_document(pose.other, size_known),
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectResult:
    """Targets found in all images."""

    images: tuple[Path, ...]
    """Images that could be read."""
    sightings: tuple[Sighting, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each, see `PhotographNotes`."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""


def detect_in_photographs(
    paths: Sequence[Path],
    targets: Sequence[Target],
    camera: Camera | None = None,
    response: CameraResponse | None = None,
    progress: Callable[[float], None] | None = None,
    on_photograph: Callable[[Photograph], None] | None = None,
) -> DetectResult:
    """Find targets in photographs."""
    if not paths:
        raise ConfigurationError("expected images or folders of images, got none")
    search = PhotographSearch(targets, [camera], response)
    views = [[path] for path in list_photographs(paths)]
    read: list[Path] = []
    sightings: list[Sighting] = []
    for (photograph,) in search.search(views, progress, is_single=len(views) == 1):
        path, _, found = photograph
        read.append(path)
        sightings += [Sighting(str(path), d, *target_centre_px(d, camera)) for d in found]
        if on_photograph is not None:
            on_photograph(photograph)
    return DetectResult(
        images=tuple(read),
        sightings=tuple(sightings),
        remarks=search.remarks(read),
        failures=tuple(search.failures),
    )


def load_camera(
    head: str | None,
    calibration: Path | None,
    eye: str | None,
    *,
    size: tuple[int, int] | None = None,
    lens: str | None = None,
) -> tuple[Camera | None, tuple[str, ...]]:
    """Load the camera that options name, None if none, and phrases on its doubtful values."""
    if head is not None and calibration is not None:
        raise ConfigurationError("camera: expected either --head or --camera, got both")
    for option, given in (("size", size), ("lens", lens)):
        if given is not None and calibration is None:
            raise ConfigurationError(f"{option}: expected --camera beside it, got none")
    if head is not None:
        if eye is None:
            raise ConfigurationError("eye: expected left or right beside --head, got none")
        return Camera.of(load_head(head), EYE_NAMES.index(eye)), ()
    if calibration is None:
        if eye is not None:
            raise ConfigurationError("eye: expected --head or --camera beside it, got neither")
        return None, ()
    if calibration.suffix.lower() == ".toml":
        raise ConfigurationError(
            f"camera: expected a calibration of OpenCV, ROS or kalibr, got {calibration} (a head "
            "file is given as --head, with --eye left or right)"
        )
    both = read_intrinsics([calibration], size=size, lens=lens)
    if eye is None and both.left is not both.right:
        raise ConfigurationError(
            f"eye: expected left or right, as {calibration} is of two cameras, got none"
        )
    return both.right if eye == "right" else both.left, both.guesses


def centre_weights(corners_m: FloatArray, found_mask: NDArray[np.bool_]) -> FloatArray:
    """(n,) weights whose mean is the centre by the affine fit; nan for corners on a line."""
    weights = np.zeros(len(corners_m))
    from_middle = (corners_m - corners_m.mean(axis=0))[found_mask]
    design = np.column_stack([np.ones(len(from_middle)), from_middle / np.ptp(corners_m)])
    if len(from_middle) < 3 or np.linalg.matrix_rank(design, tol=1e-6) < 3:
        return np.full(len(corners_m), np.nan)
    weights[found_mask] = np.linalg.pinv(design)[0]
    return weights


def weighted_sum(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sum of rows; rows with weight 0 are ignored, even if they are nan."""
    used = weights != 0.0
    return np.asarray(np.tensordot(weights[used], values[used], axes=1))


def target_centre_px(detection: Detection, camera: Camera | None) -> tuple[FloatArray, FloatArray]:
    """(2,) pixel of a target's centre, for a board by a homography, and (2,) its sigma; or nan."""
    target = detection.target
    if isinstance(target, AprilTag):
        return detection.point_px, detection.sigma_px
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(detection.corners_px).all(axis=-1))
    weights = centre_weights(target.corners_m, seen)
    nowhere = np.full(2, np.nan)
    if seen.sum() < 4 or not np.isfinite(weights).all():
        return nowhere, nowhere
    corners = detection.corners_px[seen]
    plane = corners if camera is None else camera.rays(corners)
    fitted: Any = cv2.findHomography(target.corners_m[seen], plane)
    homography = fitted[0]
    if homography is None:
        return nowhere, nowhere
    ray = homography @ [*target.corners_m.mean(axis=0), 1.0]
    middle = ray[:2] / ray[2]
    if camera is not None:
        middle = camera.project([[*middle, 1.0]])[0]
    return middle, np.sqrt(weighted_sum(detection.corners_sigma_px**2, weights**2))

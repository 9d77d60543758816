"""Find targets in single photographs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.parts import FloatArray
from vergence.operands import null_nonfinite_rows
from vergence.perception.board_centre import target_centre_px
from vergence.perception.photographs import list_photographs, remark_on_orientation_tags
from vergence.perception.target_finder import Photograph, PhotographNotes, TargetFinder, tag_number
from vergence.vision import Detection


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
        return {
            "image": self.image,
            "target": str(self.detection.target),
            "id": tag_number(self.detection.target),
            "centre_px": null_nonfinite_rows(self.centre_px),
            "corners_px": null_nonfinite_rows(self.detection.corners_px),
            "sigma_px": null_nonfinite_rows(self.sigma_px),
            "corners_sigma_px": null_nonfinite_rows(self.detection.corners_sigma_px),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectResult:
    """Targets found in all images."""

    images: tuple[Path, ...]
    """Images that could be read."""
    sightings: tuple[Sighting, ...]
    remarks: tuple[str, ...]
    """Notes for the user, one line each: targets that are in no image although others are, clipped
    white, a response that seems wrong."""
    failures: tuple[str, ...]
    """Images that could not be read, one line each."""

    def rows(self) -> list[dict[str, Any]]:
        """One row per sighting, plain values."""
        return [sighting.document() for sighting in self.sightings]


def detect_in_photographs(
    paths: Sequence[Path],
    finder: TargetFinder,
    progress: Callable[[float], None] | None = None,
    on_photograph: Callable[[Photograph], None] | None = None,
) -> DetectResult:
    """Find targets in photographs."""
    if not paths:
        raise ConfigurationError("expected images or folders of images, got none")
    every = list_photographs(paths)
    read: list[Path] = []
    sightings: list[Sighting] = []
    failures: list[str] = []
    unseen = PhotographNotes(finder.targets)
    for number, path in enumerate(every, 1):
        try:
            photograph = finder.find_in_file(path)
        except VergenceError as error:
            if len(every) == 1:
                raise
            failures.append(str(error))
            continue
        read.append(path)
        unseen.add(photograph)
        sightings += [
            Sighting(str(path), d, *target_centre_px(d, finder.camera))
            for d in photograph.detections
        ]
        if on_photograph is not None:
            on_photograph(photograph)
        if progress is not None:
            progress(number / len(every))
    if not read:
        raise ConfigurationError(
            f"expected images that can be read, got none in {len(every)}; the first: {failures[0]}"
        )
    return DetectResult(
        images=tuple(read),
        sightings=tuple(sightings),
        remarks=(
            *unseen.notes(),
            *finder.response_check.notes(),
            *remark_on_orientation_tags(read),
        ),
        failures=tuple(failures),
    )

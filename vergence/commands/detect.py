"""`vergence detect`: detect targets in single photographs or in a live camera."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from vergence.commands.console import (
    print_guesses,
    print_read_errors,
    print_to_stderr,
    progress_bar,
)
from vergence.commands.options import (
    CalibrationLens,
    CalibrationSize,
    check_figure,
    parse_size,
)
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.models.camera import CameraResponse
    from vergence.perception.finding import DetectResult
    from vergence.vision import Camera
    from vergence.vision.objects.targets import GazeTarget
    from vergence.vision.targets import Target

_MOST_PANELS: Final = 12
"""Most photographs in one figure (chosen: overview against size of each)."""


@dataclass(frozen=True, kw_only=True)
class Detect:
    """Find tags and boards in photographs or live images, with standard deviations."""

    images: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="IMAGE..."),
    ] = ()
    """Images, or folders of images."""
    target: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="TARGET"),
    ] = ()
    """Target to find; repeatable. tag:FAMILY[:ID[:EDGE]] such as tag:36h11,
    checkerboard:COLUMNSxROWS[:SQUARE] such as checkerboard:9x6 (inner corners),
    charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy] (squares; legacy: layout of OpenCV
    before 4.6), aprilgrid:COLUMNSxROWS:TAG:SPACING such as aprilgrid:6x6:88:0.3 (kalibr's
    tagCols, tagRows, tagSize, tagSpacing); lengths in mm. With --live also colour:#RRGGBB,
    face:MODEL.onnx or mine.py:Class."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head whose camera took the images, a preset's name or the path of a TOML file; with --eye."""
    eye: Annotated[
        Literal["left", "right"] | None,
        tyro.conf.arg(help_behavior_hint="", metavar="{left,right}"),
    ] = None
    """Eye of the head that took the images."""
    camera: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """Calibration of the camera (OpenCV, ROS, kalibr) instead of a head; with --eye for a pair."""
    size: CalibrationSize = None
    lens: CalibrationLens = None
    response: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TEXT")] = None
    """Light as a function of grey level: srgb, linear, a gamma such as 2.2, or a table such as
    0,0.2,1."""
    figure: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """PNG file in an existing folder to draw detections to; up to 12 images, detections first."""
    live: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="DEVICE")] = None
    """Camera to watch instead of photographs: a number, a path such as /dev/video0, a video file or
    a URL. Ctrl-C ends it."""
    seconds: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="FLOAT")] = None
    """With --live: time limit, s."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        self._check()
        from vergence.models.camera import parse_response
        from vergence.perception.finding import load_camera, parse_targets
        from vergence.vision.objects.targets import parse_gaze_target

        if self.live is not None and self.target:
            targets: Sequence[GazeTarget] = [parse_gaze_target(text) for text in self.target]
        else:
            targets = parse_targets(self.target)
        camera, guesses = load_camera(
            self.head, self.camera, self.eye, size=parse_size(self.size), lens=self.lens
        )
        print_guesses(guesses)
        response = None if self.response is None else parse_response(self.response)
        if self.live is not None:
            from vergence.commands.live import watch_camera

            return watch_camera(
                self.live,
                targets,
                camera,
                self.seconds,
                camera_response=response,
                as_json=self.json,
            )
        return self._photographs(parse_targets(self.target), camera, response)

    def _check(self) -> None:
        if self.live is None:
            if self.seconds is not None:
                raise ConfigurationError("seconds: expected only with --live, got it alone")
            if not self.images:
                raise ConfigurationError(
                    "expected images or folders of images, or --live, got none"
                )
            if self.figure is not None:
                check_figure(self.figure, self.images)
            return
        for option, given in (("images", bool(self.images)), ("figure", self.figure is not None)):
            if given:
                raise ConfigurationError(f"{option}: expected none with --live, got some")
        if self.seconds is not None and not 0.0 < self.seconds < float("inf"):
            raise ConfigurationError(f"seconds: expected more than 0, got {self.seconds}")

    def _photographs(
        self, targets: "list[Target]", camera: "Camera | None", response: "CameraResponse | None"
    ) -> int:
        from vergence.perception.finding import Photograph, detect_in_photographs
        from vergence.perception.notes import describe_similar_targets
        from vergence.vision import read_image

        shown: list[Photograph] = []

        def keep(photograph: Photograph) -> None:
            # replaces one without detections
            if len(shown) == _MOST_PANELS and photograph.detections:
                empty = [place for place, other in enumerate(shown) if not other.detections]
                if empty:
                    del shown[empty[-1]]
            if len(shown) < _MOST_PANELS:
                shown.append(photograph)

        with progress_bar("detect") as report:
            on_photograph = keep if self.figure else None
            result = detect_in_photographs(
                self.images, targets, camera, response, report, on_photograph
            )
        if self.figure is not None:
            from vergence.perception.pictures import draw_photographs

            draw_photographs(shown, self.figure)
            left = len(result.images) - len(shown)
            more = f", without {left} of the images" if left else ""
            print_to_stderr(f"{self.figure} is written{more}")
        if self.json:
            rows = [sighting.document() for sighting in result.sightings]
            print(json.dumps(rows, indent=2, allow_nan=False))
        elif result.sightings:
            _print(result)
        for text in result.remarks:
            print_to_stderr(text)
        print_read_errors(result.failures)
        if not result.sightings:
            count = len(result.images)
            where = f"any of {count} images" if count > 1 else str(result.images[0])
            there = describe_similar_targets(read_image(result.images[0]), targets, camera)
            hint = f"; in {result.images[0].name} {there}" if there else ""
            print_to_stderr(
                f"error: expected {', '.join(self.target)} in {where}, found none{hint}"
            )
        return 2 if result.failures else 0 if result.sightings else 1


def _print(result: "DetectResult") -> None:
    from vergence.reporting.text import format_fixed

    rows = []
    for sighting in result.sightings:
        found = sighting.detection
        seen = int((found.corners_px[:, 0] == found.corners_px[:, 0]).sum())
        rows.append(
            [
                Path(sighting.image).name,
                str(found.target),
                f"{seen} of {len(found.corners_px)}",
                *(format_fixed(value, 3) for value in (*sighting.centre_px, *sighting.sigma_px)),
            ]
        )
    head = ["image", "target", "corners", "u (px)", "v (px)", "sigma u (px)", "sigma v (px)"]
    print_table(head, rows, wrapped=(0, 1), shortenable=(0,))
    seen_in = len({sighting.image for sighting in result.sightings})
    if len(result.images) > 1:
        print(f"something found in {seen_in} of {len(result.images)} images")

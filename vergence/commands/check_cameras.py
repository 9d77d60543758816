"""`vergence check-cameras`: compare requested settings of cameras with their images."""

from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.options import parse_size
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.hardware.checks import CameraRequest, CameraState

_COLUMNS: Final = ("camera", "setting", "asked", "got")


@dataclass(frozen=True, kw_only=True)
class CheckCameras:
    """Check streaming cameras: sizes, rates, pixel formats, exposures, USB bandwidth."""

    sources: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="SOURCE..."),
    ] = ()
    """Cameras to check instead of those of --config: numbers, device files or URLs."""
    config: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Configuration of a robot: checks its cameras with the settings in it and in its head."""
    size: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="WxH")] = None
    """Image size to request, such as 640x480; the cameras' own by default."""
    rate: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="HZ")] = None
    """Frame rate to request, Hz; the cameras' own by default."""
    pixel_format: Annotated[str, tyro.conf.arg(help_behavior_hint="", metavar="FOUR")] = ""
    """Pixel format to request, such as MJPG; the cameras' own by default."""

    def run(self) -> int:
        """Run the command."""
        requests = self._requests()
        from vergence.hardware.checks import check_cameras

        states, findings = check_cameras(requests)
        if states:
            print_table(_COLUMNS, [row for state in states for row in _rows(state)], wrapped=(0, 1))
        for finding in sorted(findings, key=lambda finding: finding.warning):
            print_to_stderr(f"{'warning' if finding.warning else 'error'}: {finding}")
        return int(not all(finding.warning for finding in findings))

    def _requests(self) -> "list[CameraRequest]":
        if (self.config is None) == (not self.sources):
            raise ConfigurationError("expected either --config PATH or cameras, such as 0 2")
        if self.config is not None and (self.size, self.rate, self.pixel_format) != (
            None,
            None,
            "",
        ):
            raise ConfigurationError(
                "size, rate, pixel-format: expected with cameras, got --config, which has its own"
            )
        if self.rate is not None and not 0.0 < self.rate <= 1000.0:
            raise ConfigurationError(f"rate: expected images a second up to 1000, got {self.rate}")
        if len(self.pixel_format) not in (0, 4):
            raise ConfigurationError(
                f"pixel-format: expected four letters, such as MJPG, got {self.pixel_format!r:.80}"
            )
        size = parse_size(self.size)
        from vergence.hardware.checks import CameraRequest, camera_requests
        from vergence.hardware.config import load_hardware

        if self.config is not None:
            return list(camera_requests(load_hardware(self.config)))
        return [
            CameraRequest(
                name=source,
                source=source,
                size=size,
                frame_rate_hz=self.rate,
                pixel_format=self.pixel_format,
            )
            for source in dict.fromkeys(self.sources)
        ]


def _rows(state: "CameraState") -> list[list[str]]:
    """Rows of a camera's table, one for each setting."""
    request = state.request
    exposure = {True: "locked", False: "automatic", None: "-"}[state.exposure_locked]
    if not isnan(state.exposure_s):
        exposure += f", {1e3 * state.exposure_s:.1f} ms"
    rows = [
        ["size", _size(request.size), _size(state.size)],
        ["pixel format", request.pixel_format or "-", state.pixel_format or "-"],
        ["rate as set (Hz)", _number(request.frame_rate_hz), _number(state.reported_hz)],
        ["rate measured (Hz)", _number(request.frame_rate_hz), _number(state.rate_hz)],
        [
            "exposure",
            "-" if request.exposure_s is None else f"locked, {1e3 * request.exposure_s:.1f} ms",
            exposure,
        ],
    ]
    if not isnan(state.alone_hz):
        rows.insert(4, ["rate alone (Hz)", _number(request.frame_rate_hz), _number(state.alone_hz)])
    return [[request.name if not place else "", *row] for place, row in enumerate(rows)]


def _size(size: tuple[int, int] | None) -> str:
    return "-" if size is None else f"{size[0]} x {size[1]}"


def _number(value: float | None) -> str:
    return "-" if value is None or isnan(value) else f"{value:.1f}"

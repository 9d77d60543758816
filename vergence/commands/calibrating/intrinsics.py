"""`vergence calibrate intrinsics`: calibrate one camera from photographs of a board."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.calibrating.common import CalibrationOptions
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.calibration.calibrate import Calibration


@dataclass(frozen=True, kw_only=True)
class CalibrateIntrinsics(CalibrationOptions):
    """Calibrate one camera; write a file for `--camera` of detect and `--intrinsics` of import.

    The file has the keys of ROS's camera_info files.
    """

    images: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="IMAGE..."),
    ] = ()
    """Photographs of the board: files, folders, or patterns in quotes."""
    out: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("camera.yaml")
    """Calibration file to write."""

    endings = (".yaml", ".yml")

    def run(self) -> int:
        """Run the command."""
        self.check(self.out)
        from vergence.perception.photographs import list_photographs

        if not self.images:
            raise ConfigurationError("expected images or folders of images, got none")
        from vergence.calibration.calibrate import ros_camera_document

        def text(calibration: "Calibration") -> str:
            import yaml

            return str(yaml.safe_dump(ros_camera_document(calibration), sort_keys=False))

        return self.calibrate_and_save([list_photographs(self.images)], self.out, text)

"""`vergence import urdf`: make a head file from a robot's URDF or MJCF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from vergence.commands.console import print_guesses
from vergence.commands.importing.head_output import (
    HeadOutput,
    RepeatableValues,
    flatten_repeated_option,
)
from vergence.commands.options import CalibrationLens, CalibrationSize, parse_size
from vergence.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class ImportUrdf(HeadOutput):
    """Extract a head from a URDF or MJCF: two cameras, the joints that turn them, and the neck."""

    file: Annotated[Path, tyro.conf.Positional]
    """URDF or MJCF of the robot; meshes are not needed."""
    base: Annotated[str, tyro.conf.arg(metavar="FRAME")]
    """Frame that the neck is mounted on: a link (URDF), or a body, site or camera (MJCF)."""
    left_camera: Annotated[str, tyro.conf.arg(metavar="FRAME", help_behavior_hint="(required)")] = (
        ""
    )
    """Frame of the left camera."""
    right_camera: Annotated[
        str, tyro.conf.arg(metavar="FRAME", help_behavior_hint="(required)")
    ] = ""
    """Frame of the right camera."""
    neck: Annotated[tuple[str, ...], tyro.conf.arg(help_behavior_hint="", metavar="JOINT...")] = ()
    """Joints of the neck, up to three, from the base up."""
    lock: Annotated[RepeatableValues, tyro.conf.arg(metavar="JOINT=DEG")] = ()
    """Joints between the base and the cameras to hold at these angles; a prismatic joint as
    JOINT=0.1m."""
    camera_axes: Annotated[RepeatableValues, tyro.conf.arg(metavar="RIGHT,DOWN,FORWARD")] = ()
    """Axes of the camera frames that point right in the image, down in it, and forward, such as
    x,-y,-z; optical frames are x,y,z. Given twice: the left camera's, then the right one's."""
    speed: Annotated[RepeatableValues, tyro.conf.arg(metavar="RAD_S|JOINT=RAD_S")] = ()
    """Speed limit of a joint, or of all joints whose limit is missing or a placeholder."""
    acceleration: Annotated[RepeatableValues, tyro.conf.arg(metavar="RAD_S2|JOINT=RAD_S2")] = ()
    """Acceleration limit of a joint, or of all joints; neither URDF nor MJCF states it."""
    actuators: Annotated[
        tuple[Literal["common-tilt", "version-vergence"], ...],
        tyro.conf.arg(help_behavior_hint=""),
    ] = ()
    """Actuators that move both eyes: common-tilt (one for both tilts); version-vergence (one for
    equal pans, one for opposite pans). By default each eye joint has its own."""
    intrinsics: Annotated[tuple[Path, ...], tyro.conf.arg(help_behavior_hint="")] = ()
    """Calibration of the cameras (OpenCV, ROS, kalibr): one file for both, or one file each, left
    first. By default that of the MJCF's cameras, else 640x480 and 60 degrees are assumed."""
    size: CalibrationSize = None
    lens: CalibrationLens = None
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default the robot's name."""

    def run(self) -> int:
        """Run the command."""
        for side, name in (("left", self.left_camera), ("right", self.right_camera)):
            if not name:
                raise ConfigurationError(
                    f"{side}-camera: expected --{side}-camera FRAME, got none: vergence needs two "
                    "cameras (a colour and a depth frame of one device are not two)"
                )
        from vergence.commands.importing.shown import print_imported_head
        from vergence.models.urdf.import_urdf import UrdfSource, import_urdf

        imported = import_urdf(
            UrdfSource(
                file=self.file,
                base=self.base,
                cameras=(self.left_camera, self.right_camera),
                neck=self.neck,
                lock=flatten_repeated_option(self.lock),
                camera_axes=flatten_repeated_option(self.camera_axes),
                speed=flatten_repeated_option(self.speed),
                acceleration=flatten_repeated_option(self.acceleration),
                couplings=self.actuators,
                intrinsics=self.intrinsics,
                size=parse_size(self.size),
                lens=self.lens,
                name=self.name,
            )
        )
        print_guesses(imported.guesses)
        self.check()
        self.write(imported.text, imported.head)
        print_imported_head(imported, self.out)
        self.print_paths()
        return 0

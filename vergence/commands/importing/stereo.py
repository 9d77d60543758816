"""`vergence import stereo`: make a head of a calibrated pair of cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.importing.head_output import HeadOutput
from vergence.commands.options import parse_size
from vergence.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class ImportStereo(HeadOutput):
    """Make a head whose eyes do not move from a calibrated pair of cameras."""

    files: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="FILE..."),
    ]
    """Calibration files: OpenCV's (YAML, XML or JSON), two ROS camera_info files, left first, or a
    camchain of kalibr."""
    unit: Literal["m", "cm", "mm"] = "m"
    """Unit of the translation in the files: the unit in which the board's squares were given."""
    size: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="WIDTHxHEIGHT")] = None
    """Image size in pixels, such as 640x480, if the files do not have it."""
    lens: Annotated[
        Literal["brown-conrady", "rational", "fisheye"] | None,
        tyro.conf.arg(help_behavior_hint="", metavar="{brown-conrady,rational,fisheye}"),
    ] = None
    """Lens model, if the files do not name it; inferred from the coefficient count by default."""
    swap: bool = False
    """Take the first camera of the files as the right one."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default the name of its file."""

    def run(self) -> int:
        """Run the command."""
        if not self.files:
            raise ConfigurationError("files: expected calibration files, got none")
        from vergence.commands.importing.shown import print_imported_pair
        from vergence.models.files.head_toml import parse_head
        from vergence.models.files.import_stereo import stereo_pair_to_head_toml
        from vergence.models.files.stereo import read_stereo

        pair = read_stereo(
            self.files, unit=self.unit, size=parse_size(self.size), lens=self.lens, swap=self.swap
        )
        for guess in pair.guesses:
            print_to_stderr(f"assumed: {guess}")
        text = stereo_pair_to_head_toml(pair, self.name or self.out.stem)
        head = parse_head(text)
        self.check()
        self.write(text, head)
        print_imported_pair(head)
        self.print_paths()
        return 0

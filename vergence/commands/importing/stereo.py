"""`vergence import stereo`: make a head of a calibrated pair of cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vergence.commands.console import print_guesses
from vergence.commands.importing.head_output import HeadOutput
from vergence.commands.options import CalibrationLens, CalibrationSize, parse_size
from vergence.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class ImportStereo(HeadOutput):
    """Make a head whose eyes do not move from a calibrated pair of cameras."""

    files: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help_behavior_hint="", metavar="FILE..."),
    ]
    """Calibration files: OpenCV's (YAML, XML or JSON), two ROS camera_info files, left first, a
    camchain of kalibr, two sensor.yaml files of EuRoC, or settings of ORB-SLAM2."""
    unit: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="UNIT")] = None
    """Unit of the translation in the files, in which the board's squares were given: m, cm, mm; or
    the length of a square, such as 25mm, if they had no size. By default that in the files, else
    m."""
    size: CalibrationSize = None
    lens: CalibrationLens = None
    swap: bool = False
    """Take the first camera of the files as the right one."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default the name of its file."""

    def run(self) -> int:
        """Run the command."""
        if not self.files:
            raise ConfigurationError("files: expected calibration files, got none")
        from vergence.commands.importing.shown import print_imported_pair
        from vergence.models.head_file import head_of_document
        from vergence.models.stereo_files import document_of_pair, read_stereo
        from vergence.models.toml_table import toml_text

        pair = read_stereo(
            self.files, unit=self.unit, size=parse_size(self.size), lens=self.lens, swap=self.swap
        )
        print_guesses(pair.guesses)
        document = document_of_pair(pair, self.name or self.out.stem)
        head = head_of_document(document)
        self.check()
        self.write(toml_text(document), head)
        print_imported_pair(head)
        self.print_paths()
        return 0

"""`vergence calibrate stereo`: calibrate a fixed camera pair from photographs of a board."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.calibrating.common import CalibrationOptions
from vergence.commands.console import print_to_stderr
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.calibration.calibrate import Calibration


@dataclass(frozen=True, kw_only=True)
class CalibrateStereo(CalibrationOptions):
    """Calibrate two cameras that are fixed to each other; write them as a head file."""

    left: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="IMAGE...")]
    """Photographs of the left camera: files, folders, or patterns in quotes."""
    right: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="IMAGE...")]
    """Photographs of the right camera, taken at the same moments and named alike."""
    out: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("pair.toml")
    """Head file to write."""
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Name of the head; by default the name of its file."""

    endings = (".toml",)

    def run(self) -> int:
        """Run the command."""
        self.check(self.out)
        from vergence.models.head_file import check_head_name
        from vergence.perception.photographs import join_first_names, list_photographs, pair_images

        name = self.name or self.out.stem
        check_head_name(name)
        if not self.left or not self.right:
            raise ConfigurationError("left, right: expected images of both cameras, got none")
        lefts, rights = list_photographs(self.left), list_photographs(self.right)
        pairs = pair_images(lefts, rights, one_folder=lefts == rights)
        if pairs.unpaired:
            print_to_stderr(
                f"{len(pairs.unpaired)} of the images have no partner: "
                f"{join_first_names(path.name for path in pairs.unpaired)}"
            )
        from vergence.calibration.calibrate import head_file_text

        def text(calibration: "Calibration") -> str:
            return head_file_text(calibration, name, self.parsed_response())

        return self.calibrate_and_save(
            [[pair.left for pair in pairs.pairs], [pair.right for pair in pairs.pairs]],
            self.out,
            text,
        )

"""`vergence import stereo`: a calibrated pair of cameras."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vergence.commands.importing.head_output import HeadOutput
from vergence.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class ImportStereo(HeadOutput):
    """Make a head of a calibrated pair of cameras."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Calibration files."""

    def run(self) -> int:
        """Run the command."""
        raise ConfigurationError("import stereo: expected a later version of vergence")

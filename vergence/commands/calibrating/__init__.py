"""`vergence calibrate`: cameras as they are, from photographs of a board."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from vergence.commands.calibrating.intrinsics import CalibrateIntrinsics
from vergence.commands.calibrating.stereo import CalibrateStereo


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Calibrate one camera, or two that are fixed to each other, from photographs of a board."""

    what: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[CalibrateIntrinsics, tyro.conf.subcommand("intrinsics")]
            | Annotated[CalibrateStereo, tyro.conf.subcommand("stereo")]
        ]
    ]

    def run(self) -> int:
        """Run the command."""
        return self.what.run()

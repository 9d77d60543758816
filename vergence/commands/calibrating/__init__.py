"""`vergence calibrate`: calibrate cameras and heads from images of a board."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from vergence.commands.calibrating.head import CalibrateHead
from vergence.commands.calibrating.intrinsics import CalibrateIntrinsics
from vergence.commands.calibrating.stereo import CalibrateStereo


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Calibrate one camera, a fixed pair of cameras, or a head that moves."""

    what: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[CalibrateIntrinsics, tyro.conf.subcommand("intrinsics")]
            | Annotated[CalibrateStereo, tyro.conf.subcommand("stereo")]
            | Annotated[CalibrateHead, tyro.conf.subcommand("head")]
        ]
    ]

    def run(self) -> int:
        """Run the command."""
        return self.what.run()

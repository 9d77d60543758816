"""`vergence import`: make a head file from a ruler's measures, or from files of other tools."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from vergence.commands.importing.ruler import ImportRuler
from vergence.commands.importing.stereo import ImportStereo
from vergence.commands.importing.urdf import ImportUrdf


@dataclass(frozen=True, kw_only=True)
class Import:
    """Make a head file from a ruler's measures, a robot's description or a calibrated pair."""

    what: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ImportRuler, tyro.conf.subcommand("ruler")]
            | Annotated[ImportUrdf, tyro.conf.subcommand("urdf")]
            | Annotated[ImportStereo, tyro.conf.subcommand("stereo")]
        ]
    ]

    def run(self) -> int:
        """Run the command."""
        return self.what.run()

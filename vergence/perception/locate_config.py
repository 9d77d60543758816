"""Images, head and targets of a location run; also the options of `vergence locate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class LocateConfig:
    """Images, head and targets of a location run."""

    left: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LEFT")]
    """Image of the left eye, or a folder of such images."""
    right: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RIGHT")]
    """Image of the right eye taken at the same moment, or a folder of them."""
    head: Annotated[str, tyro.conf.arg(metavar="HEAD")]
    """Head that took them: the path of a TOML file, or a preset's name."""
    target: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="TARGET"),
    ] = ()
    """Target to find; repeatable. tag:FAMILY[:ID[:EDGE]] such as
    tag:36h11:5:120, checkerboard:COLUMNSxROWS[:SQUARE] such as checkerboard:9x6:24.23 (inner
    corners), charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy] (squares; legacy: as OpenCV before
    4.6 laid it out), aprilgrid:COLUMNSxROWS:TAG:SPACING such as aprilgrid:6x6:88:0.3 (kalibr's
    tagCols, tagRows, tagSize, tagSpacing); lengths in mm."""
    response: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TEXT")] = None
    """Light as a function of grey level: srgb, linear, a gamma such as 2.2, or a table such as
    0,0.2,1."""
    joints: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE")] = None
    """Joint angles at the exposure, JSON, CSV or TOML, for a head whose eyes move; one row, or one
    for each pair with the left image's name as pair. Columns are named after the head's joints, in
    rad, or in degrees with the suffix _deg. At rest by default."""

"""`vergence print-target`: draw a tag or a board to print at true scale."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from vergence.commands.options import check_writable
from vergence.errors import ConfigurationError

_FILE_SUFFIXES: Final = (".pdf", ".svg", ".png")
_DPI: Final = 300.0
"""Default resolution of a PNG, pixels per inch (chosen: sharp edges against file size)."""
_LEAST_DPI: Final = 50.0
"""Lowest resolution of a PNG, pixels per inch (chosen: refuses coarse edges)."""
_MAX_PNG_PIXELS: Final = 200e6
"""Most pixels of a PNG, each of 4 bytes while it is drawn (chosen: resolution against memory)."""
_INCH_MM: Final = 25.4
"""Millimetres per inch (physical: definition of the inch)."""


@dataclass(frozen=True, kw_only=True)
class PrintTarget:
    """Draw a tag or a board to print at true scale, with a ruler to check the print."""

    target: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TARGET")]
    """Target to print: tag:FAMILY:ID:EDGE such as tag:36h11:5:120,
    checkerboard:COLUMNSxROWS:SQUARE such as checkerboard:9x6:24 (inner corners),
    charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy] such as charuco:7x5:30:22:4X4_50 (squares), or
    aprilgrid:COLUMNSxROWS:TAG:SPACING such as aprilgrid:6x6:20:0.3 (kalibr's); lengths in mm."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("board.pdf")
    """File to write; its ending sets the format: .pdf, .svg or .png."""
    paper: Annotated[str, tyro.conf.arg(metavar="PAPER")] = "a4"
    """Paper, rotated to fit the board: a0 to a5, letter, legal, tabloid, or WIDTHxHEIGHT in mm."""
    dpi: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="FLOAT")] = None
    """Resolution of a .png, pixels per inch; 300 by default."""
    force: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(aliases=["--overwrite"])] = (
        False
    )
    """Replace an existing file."""

    def run(self) -> int:
        """Run the command."""
        self._check()
        from vergence.vision import parse_target
        from vergence.vision.printing import (
            draw_sheet,
            lay_out_sheet,
            parse_paper,
            require_printable,
        )

        paper = parse_paper(self.paper)
        sheet = lay_out_sheet(require_printable(parse_target(self.target)), paper)
        dpi = self._resolution(sheet.width_mm * sheet.height_mm)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        draw_sheet(sheet, self.out, dpi)
        turned = "landscape" if sheet.landscape else "portrait"
        print(f"{self.out}: {sheet.target} on {paper}, {turned}")
        print("print it at 100 %, not fitted to the page, and measure its ruler: 100 mm")
        return 0

    def _check(self) -> None:
        ending = self.out.suffix.lower()
        if ending not in _FILE_SUFFIXES:
            raise ConfigurationError(
                f"out: expected a name that ends in .pdf, .svg or .png, got {self.out}"
            )
        check_writable(self.out)
        if self.dpi is not None and ending != ".png":
            raise ConfigurationError(f"dpi: expected none for a {ending}, got {self.dpi:g}")
        if self.out.exists() and not self.force:
            raise ConfigurationError(
                f"out: expected no file of that name (--force replaces it), got {self.out}"
            )

    def _resolution(self, area_mm2: float) -> float:
        """Resolution of a PNG of the given area, pixels per inch."""
        dpi = _DPI if self.dpi is None else self.dpi
        most = float(int(_INCH_MM * (_MAX_PNG_PIXELS / area_mm2) ** 0.5))
        if self.out.suffix.lower() == ".png" and not _LEAST_DPI <= dpi <= most:
            raise ConfigurationError(
                f"dpi: expected {_LEAST_DPI:g} to {most:g} on this paper, got {dpi:g}"
            )
        return dpi

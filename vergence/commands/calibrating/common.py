"""Options and steps that both camera calibrations share: the board, the lens, the output files."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from vergence.commands.console import print_read_errors, print_to_stderr, progress_bar
from vergence.commands.options import (
    check_writable,
    claimed_run_folder,
    dated_run_folder,
    print_written,
)
from vergence.commands.tables import print_table
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.calibration.calibrate import Calibration
    from vergence.models.camera import CameraResponse


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions:
    """Options of both camera calibrations."""

    target: Annotated[str, tyro.conf.arg(aliases=["--board"], metavar="TARGET")]
    """The board: checkerboard:COLUMNSxROWS:SQUARE such as checkerboard:9x6:24.23 (inner corners),
    charuco:COLUMNSxROWS:SQUARE:MARKER:DICT[:legacy] (squares) or
    aprilgrid:COLUMNSxROWS:TAG:SPACING (kalibr's); lengths in mm. `vergence print-target` prints
    one."""
    lens: Annotated[
        Literal["brown-conrady", "rational", "fisheye"] | None,
        tyro.conf.arg(help_behavior_hint="", metavar="{brown-conrady,rational,fisheye}"),
    ] = None
    """Lens model; by default the one that predicts held-out views best."""
    response: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="TEXT")] = None
    """Light as a function of grey level: srgb, linear, a gamma such as 2.2, or a table such as
    0,0.2,1."""
    report: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder with the report, new or empty; runs/calibrate-DATE-TIME by default."""
    force: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Replace an existing result file."""
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    endings: ClassVar[tuple[str, ...]] = ()

    def check(self, out: Path) -> None:
        """Refuse an output file that cannot be written, before any work is done."""
        if out.suffix.lower() not in self.endings:
            raise ConfigurationError(
                f"out: expected a name that ends in {' or '.join(self.endings)}, got {out}"
            )
        check_writable(out)
        if out.exists() and not self.force:
            raise ConfigurationError(
                f"out: expected no file of that name (--force replaces it), got {out}"
            )

    def parsed_response(self) -> "CameraResponse | None":
        """Camera response given by --response; None if it is not given."""
        from vergence.models.camera import parse_response

        return None if self.response is None else parse_response(self.response)

    def calibrate_and_save(
        self,
        photographs: Sequence[Sequence[Path]],
        out: Path,
        text: Callable[["Calibration"], str],
    ) -> int:
        """Calibrate, write the result and its run folder, and print the result."""
        from vergence.calibration.advice import advise_next_photographs
        from vergence.calibration.calibrate import calibrate
        from vergence.calibration.observations import parse_board
        from vergence.calibration.report import write_run
        from vergence.files import write_atomic

        board, response = parse_board(self.target), self.parsed_response()
        with claimed_run_folder(self.report or dated_run_folder("calibrate")) as run:
            with progress_bar("calibrate") as report:
                found = calibrate(board, photographs, self.lens, report, response)
            content = text(found)
            run.save(lambda folder: write_run(folder, found, content, out.name))
            self.check(out)  # another process may have written it meanwhile
            out.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(out, content)
        advised = advise_next_photographs(found)
        if self.json:
            document = {**found.document(), "advice": advised}
            print(json.dumps(document, indent=2, allow_nan=False))
        else:
            print_calibration(found, out)
            if run.saved:
                print_written(run.folder)
        for line in advised:
            print_to_stderr(line)
        print_read_errors(found.read_errors)
        return 0 if run.saved and not found.read_errors else 2


def print_calibration(calibration: "Calibration", out: Path) -> None:
    """Print a calibration: values, residuals, views left out, and the path of its file."""
    from vergence.calibration.adjustment import rms_length

    names = calibration.camera_names
    several = len(names) > 1
    rows = []
    for name, label, value, deviation in calibration.camera_values:
        digits = 2 if label[1] == "_" else 5
        rows.append([name, label, f"{value:.{digits}f}", f"{deviation:.{digits}f}"])
    if several:
        baseline, deviation = calibration.baseline_mm
        digits = max(2, 1 - math.floor(math.log10(max(deviation, 1e-9))))
        rows.append(["pair", "baseline (mm)", f"{baseline:.{digits}f}", f"{deviation:.{digits}f}"])
    print_table(
        ["of", "number", "value", "sigma"],
        rows,
        title=f"cameras ({calibration.lens})",
        wrapped=(0, 1),
    )
    rows = [
        [f"{name} by itself", f"{each:.3f}"]
        for name, each in zip(names, calibration.rms_alone_px, strict=True)
    ]
    if several:
        rows.append(["both together", f"{rms_length(calibration.fit.solution.residuals_px):.3f}"])
    rows.append(["views held out", f"{rms_length(calibration.held_out_px):.3f}"])
    kept, every = int(calibration.fit.kept_views.sum()), len(calibration.fit.kept_views)
    print_table(["residual", "rms (px)"], rows, title=f"{kept} of {every} views", wrapped=(0,))
    if calibration.dropped:
        print_table(
            ["left out", "why"],
            [list(one) for one in calibration.dropped],
            wrapped=(0, 1),
            shortenable=(0,),
        )
    if several:
        larger = f"if it is 1 % larger, the baseline is {1.01 * calibration.baseline_mm[0]:.2f} mm"
        print(f"lengths are as right as the board ({calibration.observations.target}): {larger}\n")
    print(out)

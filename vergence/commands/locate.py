"""`vergence locate`: triangulate targets in pairs of photographs."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.console import print_read_errors, print_to_stderr, progress_bar
from vergence.commands.options import Flat, TableOptions, claimed_run_folder, dated_run_folder

if TYPE_CHECKING:
    from vergence.models.head import HeadModel
    from vergence.perception.locate import LocateResult


@dataclass(frozen=True, kw_only=True)
class LocateOptions:
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


@dataclass(frozen=True, kw_only=True)
class Locate:
    """Find tags and boards in photographs of both eyes, triangulate them, write a run folder."""

    options: Flat[LocateOptions]
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/locate-DATE-TIME by default."""
    tables: Flat[TableOptions] = field(default_factory=TableOptions)
    json: bool = False
    """Print the located targets as a JSON list, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        options = self.options
        self.tables.check()
        from vergence.commands.located import print_located_targets
        from vergence.perception.locate import locate, write_corner_table, write_target_table
        from vergence.perception.pictures import draw_located
        from vergence.reporting.runs import write_config_and_head, write_json

        def write(folder: Path) -> None:
            write_json(folder / "result.json", result.summary())
            write_corner_table(folder / "points.csv", result.located)
            write_target_table(folder / "targets.csv", result.located)
            self.tables.convert(folder / "points.csv", folder / "targets.csv")
            write_config_and_head(folder, options, result.head)
            draw_located(result, folder / "locate.png")

        with claimed_run_folder(self.out or dated_run_folder("locate")) as run:
            with progress_bar("locate") as report:
                result = locate(**vars(options), progress=report)
            if options.joints is None:
                _say_rest(result.head)
            run.finish(write, result.rows, lambda: print_located_targets(result), as_json=self.json)
        for text in result.notes():  # below the table: some explain its rows
            print_to_stderr(text)
        print_read_errors(result.failures)
        if not result.any_triangulated:
            print_to_stderr(f"error: {_nothing(options.target, result)}")
        if not run.saved or result.failures:
            return 2
        return 0 if result.any_triangulated else 1


def _nothing(targets: tuple[str, ...], result: "LocateResult") -> str:
    names = ", ".join(targets)
    if result.located:
        return f"no point of {names} has an answer: the lines of sight do not cross"
    count = len(result.angles)
    pairs = f"in both images of any of {count} pairs" if count > 1 else "in both images of the pair"
    from vergence.perception.finding import parse_targets
    from vergence.perception.notes import describe_similar_targets
    from vergence.vision import Camera

    left = result.shown[0]
    there = ""
    if not left.detections:
        camera = Camera.of(result.head, 0)
        there = describe_similar_targets(left.image, parse_targets(targets), camera)
    return f"expected {names} {pairs}, found none" + (
        f"; in {left.path.name} {there}" if there else ""
    )


def _say_rest(head: "HeadModel") -> None:
    """Note the joint angles that were assumed for movable eyes if --joints was not given."""
    import numpy as np

    from vergence.models.parts import EYES

    if not head.actuation.count:
        return
    rest = zip(head.joints[EYES], np.degrees(head.rest()[EYES]), strict=True)
    angles = ", ".join(f"{name} {angle:z.3g}" for name, angle in dict(rest).items() if name)
    print_to_stderr(f"no --joints: the eyes are taken to be at rest, in degrees {angles}")

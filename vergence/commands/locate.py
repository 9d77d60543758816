"""`vergence locate`: triangulate targets in pairs of photographs."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.console import print_read_errors, print_to_stderr, progress_bar
from vergence.commands.options import Flat, TableOptions, claimed_run_folder, dated_run_folder
from vergence.perception.locate_config import LocateConfig

if TYPE_CHECKING:
    from vergence.models.head import HeadModel
    from vergence.perception.locate import LocateResult


@dataclass(frozen=True, kw_only=True)
class Locate:
    """Find tags and boards in photographs of both eyes, triangulate them, write a run folder."""

    config: Flat[LocateConfig]
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/locate-DATE-TIME by default."""
    tables: Flat[TableOptions] = field(default_factory=TableOptions)
    json: bool = False
    """Print the located targets as a JSON list, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        from vergence.commands.located import print_located_targets
        from vergence.perception.locate import (
            LocateResult,
            locate,
            write_corner_table,
            write_target_table,
        )
        from vergence.perception.pictures import draw_located
        from vergence.reporting.runs import write_config_and_head, write_json

        def write(folder: Path) -> None:
            write_json(folder / "result.json", result.summary())
            write_corner_table(folder / "points.csv", result.located)
            write_target_table(folder / "targets.csv", result.located)
            self.tables.convert(folder / "points.csv", folder / "targets.csv")
            write_config_and_head(folder, result.config, result.head)
            draw_located(result, folder / "locate.png")

        with claimed_run_folder(self.out or dated_run_folder("locate")) as run:
            with progress_bar("locate") as report:
                result: LocateResult = locate(self.config, report)
            if self.config.joints is None:
                _say_rest(result.head)
            run.finish(write, result.rows, lambda: print_located_targets(result), as_json=self.json)
        for text in result.notes():  # below the table: some explain its rows
            print_to_stderr(text)
        print_read_errors(result.failures)
        if not result.any_triangulated:
            print_to_stderr(f"error: {_nothing(result)}")
        if not run.saved or result.failures:
            return 2
        return 0 if result.any_triangulated else 1


def _nothing(result: "LocateResult") -> str:
    names = ", ".join(result.config.target)
    if result.located:
        return f"no point of {names} has an answer: the lines of sight do not cross"
    count = len(result.pairs)
    pairs = f"in both images of any of {count} pairs" if count > 1 else "in both images of the pair"
    from vergence.perception.finding import describe_similar_targets, parse_targets
    from vergence.vision import Camera

    left = result.shown.left
    there = ""
    if not left.detections:
        targets = parse_targets(result.config.target)
        there = describe_similar_targets(left.image, targets, Camera.of(result.head, 0))
    return f"expected {names} {pairs}, found none" + (
        f"; in {left.path.name} {there}" if there else ""
    )


def _say_rest(head: "HeadModel") -> None:
    """Note the joint angles that were assumed for movable eyes if --joints was not given."""
    import numpy as np

    from vergence.models.parts import EYES
    from vergence.perception.photographs import eyes_move

    if not eyes_move(head):
        return
    rest = zip(head.joints[EYES], np.degrees(head.rest()[EYES]), strict=True)
    angles = ", ".join(f"{name} {angle:z.3g}" for name, angle in dict(rest).items() if name)
    print_to_stderr(f"no --joints: the eyes are taken to be at rest, in degrees {angles}")

"""`vergence gaze`: run one gaze, from images to a triangulated point."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from vergence import interrupts
from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.options import Flat, TableOptions, claimed_run_folder, dated_run_folder
from vergence.commands.tables import print_table
from vergence.eval.gaze_config import GazeConfig

if TYPE_CHECKING:
    from vergence.eval.gaze import GazeResult
    from vergence.models.head import HeadModel


@dataclass(frozen=True, kw_only=True)
class Gaze:
    """Turn both eyes to a target and triangulate it; write a run folder."""

    config: Flat[GazeConfig] = field(default_factory=GazeConfig)
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/gaze-DATE-TIME by default."""
    record: Annotated[
        Path | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE.gif|mp4|webp")
    ] = None
    """Also record a short film of the gaze: the head from outside, both eyes' images, and the pixel
    error over time."""
    tables: Flat[TableOptions] = field(default_factory=TableOptions)
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        if self.record is not None:
            from vergence.viewer.film_files import check_film

            check_film(self.record)
        from vergence.eval.gaze import GazeResult, run_gaze
        from vergence.eval.gaze_figure import draw_gaze
        from vergence.eval.gaze_trajectory import write_trajectory
        from vergence.reporting.runs import write_config_and_head, write_json

        def write(folder: Path) -> None:
            write_json(folder / "result.json", result.summary())
            write_trajectory(result.trajectory, folder / "trajectory.csv")
            self.tables.convert(folder / "trajectory.csv")
            write_config_and_head(folder, result.config, result.head)
            if result.config.hardware is not None:
                shutil.copyfile(result.config.hardware, folder / "hardware.toml")
            draw_gaze(result, folder / "gaze.png")

        film = None
        if self.record is not None:
            from vergence.viewer.film import GazeFilm

            film = GazeFilm(self.config.duration_s)
        if self.config.hardware is not None:
            interrupts.raise_on_termination()
        with claimed_run_folder(self.out or dated_run_folder("gaze")) as run:
            with progress_bar("gaze") as report:
                result: GazeResult = run_gaze(
                    self.config, report, None if film is None else film.watch
                )
            run.finish(write, result.summary, lambda: _print_gaze(result), as_json=self.json)
            if film is not None and self.record is not None:
                with progress_bar("film") as report:
                    film.write(self.record, result, report)
                if not self.json:
                    print(f"film written to {self.record}")
        return _verdict(result) if run.saved else 2


def _print_gaze(result: "GazeResult") -> None:
    import numpy as np

    from vergence.models import look_at
    from vergence.models.parts import JOINTS
    from vergence.reporting.text import METHODS_LEGEND, format_fixed

    if result.head.joints != JOINTS:
        print(_describe_joints(result.head))
    if result.has_residual:
        print(
            f"{result.limitation}: the least error that the actuators allow is "
            f"{result.residual_px:.3g} px in the worse eye\n"
            f"within 1 px of it after {_seconds(result.settle_1px_s)}, "
            f"within 0.5 px after {_seconds(result.settle_05px_s)}"
        )
    if result.config.target == "place":
        print(look_at(result.head, np.asarray(result.config.target_mm) / 1000.0))
    if not result.has_residual and result.has_truth:
        print(
            f"settled to 1 px after {_seconds(result.settle_1px_s)}, "
            f"to 0.5 px after {_seconds(result.settle_05px_s)}"
        )
    rows = []
    if result.has_truth:
        rows.append(["truth", *(format_fixed(1e3 * v, 3) for v in result.true_target_m), ""])
    for name, fix in (("gaze", result.gaze_fix), ("ITPC", result.view_fix)):
        point, sigma = 1e3 * fix.point[0], 1e3 * fix.sigma[0]
        gap = format_fixed(1e3 * fix.gap[0], 4)
        rows.append([name, *(format_fixed(v, 3) for v in point), gap])
        rows.append([f"{name}, 1 sigma", *(format_fixed(v, 3) for v in sigma), ""])
        if result.has_truth:
            error = point - 1e3 * result.true_target_m
            rows.append([f"{name}, error", *(format_fixed(v, 3, signed=True) for v in error), ""])
    if result.diagnostics:
        print(_describe_loop(result.diagnostics))
    print_table(["", "x (mm)", "y (mm)", "z (mm)", "common perpendicular (mm)"], rows)
    Console(highlight=False).print(METHODS_LEGEND)


def _describe_loop(counts: dict[str, int]) -> str:
    """Line with the counters of a robot's loop."""
    return "loop: " + ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in counts.items())


def _describe_joints(head: "HeadModel") -> str:
    """Line that names a head's joints, and its actuators if these couple joints."""
    from vergence.eval.head_summary import coupled_actuator_summaries

    names = [name for name in dict.fromkeys(head.joints) if name]
    text = f"head {head.name}: joints {', '.join(names)}"
    if list(head.actuation.names) == names[-head.actuation.count :]:
        return text
    moved = (f"{one.name} ({one.moves})" for one in coupled_actuator_summaries(head))
    return f"{text}; actuators {', '.join(moved)}"


def _seconds(value: float) -> str:
    return f"{value:.3f} s" if value == value else "- (never)"


def _verdict(result: "GazeResult") -> int:
    """Exit code: 1 if a target was not visible, not fixated or not triangulated, else 0."""
    from vergence.models.parts import EYE_NAMES

    unseen = [eye for eye in EYE_NAMES if not result.trajectory[f"visible_{eye}"].any()]
    if unseen:
        why = f": {result.remark}" if result.remark else ""
        eyes = " and the ".join(unseen)
        print_to_stderr(f"error: the target was never seen by the {eyes} eye{why}")
        return 1
    fixed_pair = result.head.has_fixed_pair
    for name, fix in (("gaze", result.gaze_fix), ("ITPC", result.view_fix)):
        if name == "gaze" and not fix.valid[0] and (fixed_pair or result.residual_px > 1.0):
            why = (
                "no joint turns one eye alone" if fixed_pair else "the eyes cannot both look at it"
            )
            print_to_stderr(
                f"gaze found no point: the optical axes do not cross at the target, as {why}; "
                "ITPC's point comes from the images"
            )
        elif not fix.valid[0]:
            print_to_stderr(
                f"error: {name} found no point: expected two rays that cross in front of both "
                "eyes, got near-parallel rays, a crossing behind them, or an eye without the target"
            )
            return 1
    if result.has_truth and result.settle_1px_s != result.settle_1px_s:
        where = " of their least error" if result.has_residual else ""
        print_to_stderr(f"error: the eyes did not settle to within 1 px{where} in the trial")
        return 1
    return 0

"""`vergence replay`: evaluate a robot's log and rerun a policy on its readings."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.extras import require_modules
from vergence.commands.gaze_rows import print_gazes
from vergence.commands.options import Flat, TableOptions, claimed_run_folder, dated_run_folder
from vergence.commands.tables import print_table
from vergence.eval.robot.config import ReplayConfig

if TYPE_CHECKING:
    from vergence.eval.robot.replay import Replay


@dataclass(frozen=True, kw_only=True)
class ReplayLog:
    """Read a robot's log, complete or truncated: write tables and a figure, rerun a policy."""

    config: Flat[ReplayConfig]
    out: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """Run folder, new or empty; runs/replay-DATE-TIME by default."""
    tables: Flat[TableOptions] = field(default_factory=TableOptions)
    json: bool = False
    """Print the result as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run the command."""
        self.tables.check()
        require_modules("robot", "mcap")
        from vergence.eval.robot.replay import replay
        from vergence.eval.robot.replay_folder import write_replay_folder

        with claimed_run_folder(self.out or dated_run_folder("replay")) as run:
            with progress_bar("replay") as report:
                result = replay(self.config, report)
            for text in result.notes:
                print_to_stderr(text)
            if not result.log.trials:
                print_to_stderr(f"there is no gaze in {result.log.path}")
            if result.log.truncation_reason:
                print_to_stderr(f"{result.log.path} is cut off, as by a crash: read up to there")

            def write(folder: Path) -> None:
                write_replay_folder(folder, result, self.config.gaze)
                self.tables.convert(*sorted(folder.glob("*.csv")))

            run.finish(write, result.summary, lambda: _print(result), as_json=self.json)
        for text in result.log.stop_reasons:
            print_to_stderr(f"the log has a fault: {text}")
        return 0 if run.saved else 2


def _print(result: "Replay") -> None:
    print_gazes(result.gazes.rows(), result.summary())
    if result.gazes.dry_run:
        print("a dry run: nothing has moved")
    if result.rerun is None:
        return
    rows = [
        [
            str(row["gaze"]),
            f"{row['identical']} of {row['commands']}",
            f"{row['rms_difference_rad_s']:.3g}",
            f"{row['greatest_difference_rad_s']:.3g}",
        ]
        for row in result.rerun.rows()
    ]
    title = f"{result.rerun.controller}, asked again on the log's readings"
    columns = ("gaze", "identical commands", "rms difference (rad/s)", "greatest (rad/s)")
    print_table(columns, rows, title=title, wrapped=())

"""The run folder of a replay."""

from pathlib import Path

import pandas as pd

from vergence.eval.gaze_figure import draw_gaze
from vergence.eval.robot.replay import Replay, RerunCommands
from vergence.models.head import HeadModel
from vergence.models.head_file import save_head
from vergence.recording import schema
from vergence.recording.log import recover_log
from vergence.reporting.runs import write_json


def write_replay_folder(folder: Path, replay: Replay, drawn_gaze: int | None = None) -> None:
    """Write tables and the picture of one gaze; for a truncated log, also a repaired copy.

    Args:
        folder: the run folder.
        replay: the replayed log.
        drawn_gaze: number of the gaze to draw, counted from 1; None for the last one.
    """
    log = replay.log
    write_json(folder / "result.json", replay.summary())
    pd.DataFrame(replay.gazes.rows()).to_csv(folder / "gazes.csv", index=False)
    if replay.rerun is not None and replay.results:
        _commands(replay.rerun, log.head).to_csv(folder / "commands.csv", index=False)
    save_head(log.head, folder / schema.HEAD_FILE)
    (folder / schema.CONFIG_FILE).write_text(log.config, encoding="utf-8")
    if log.truncation_reason:
        recover_log(log.path, folder / "recovered.mcap")
    replay.trajectory().to_csv(folder / "trajectory.csv", index=False)
    if replay.results:
        draw_gaze(replay.results[-1 if drawn_gaze is None else drawn_gaze - 1], folder / "gaze.png")


def _commands(rerun: RerunCommands, head: HeadModel) -> pd.DataFrame:
    """A row per control period: commands of the log's policy and of the one run again, rad/s."""
    parts = []
    for place, (logged, computed) in enumerate(zip(rerun.logged, rerun.computed, strict=True)):
        columns: dict[str, object] = {"gaze": place + 1, "period": range(1, len(logged) + 1)}
        for slot, name in enumerate(head.actuation.names, 3):
            columns[f"logged_{name}_rad_s"] = logged[:, slot]
            columns[f"asked_{name}_rad_s"] = computed[:, slot]
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)

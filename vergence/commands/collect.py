"""`vergence collect`: record a head that looks at a board, for its calibration."""

import shlex
import tomllib
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from vergence import interrupts
from vergence.commands.console import print_to_stderr, progress_bar
from vergence.commands.extras import require_modules
from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.calibration.head.calibrate import CalibrationPreview
    from vergence.calibration.head.collect import CollectedRecording
    from vergence.models.head import HeadModel
    from vergence.recording.events import Looker
    from vergence.vision.targets import PlanarTarget

_ROBOT_LOOKER_MODULE: Final = "vergence.hardware.robot"
"""Module of the `Looker` of a robot."""
_DEFAULT_HEAD: Final = "simulated"
_DEFAULT_DISTANCE_M: Final = 0.7
"""Default distance of a simulated board, m (chosen: a usual working distance)."""
_NEAREST_M: Final = 0.05
"""Smallest distance of a simulated board, m (chosen: refuses another unit, not a real setup)."""
_FARTHEST_M: Final = 50.0
"""Largest distance of a simulated board, m (chosen: as above)."""
_MOST_ERROR_SCALE: Final = 20.0
"""Largest scale of a simulated head's errors (chosen: far beyond real heads)."""


@dataclass(frozen=True, kw_only=True)
class Collect:
    """Record a head that looks at a stationary board in many postures, for its calibration.

    Called again, it continues the recording in the folder.
    """

    folder: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(name="recording", metavar="RECORDING")
    ]
    """Folder of the recording, new or to be continued."""
    target: Annotated[str, tyro.conf.arg(aliases=["--board"], metavar="TARGET")]
    """The board, such as checkerboard:9x6:24 or tag:36h11:0:120; lengths in mm."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; by default simulated, or on a robot the
    head of its configuration."""
    plant: Literal["kinematic", "rendered", "hardware"] = "kinematic"
    """Plant to record: kinematic (projected corners with noise), rendered (drawn images and a
    detector), hardware (a robot, or vergence emulate)."""
    config: Annotated[Path | None, tyro.conf.arg(help_behavior_hint="", metavar="PATH")] = None
    """TOML file that describes the robot of --plant hardware (see docs/robot.md)."""
    poses: int = 60
    """Head poses for one position of the board, including those of earlier runs."""
    frames: int = 8
    """Frames of a pose; joint angles differ slightly between them."""
    until: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="PERCENT")] = None
    """Stop as soon as the standard deviation of depth, straight ahead at 1 m and 2.5 m, is at most
    so many per cent."""
    moved: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """The board has been moved since the last run."""
    seed: int = 0
    """Seed of postures, noise and a simulated head's errors."""
    distance: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="FLOAT")] = None
    """Distance of a simulated board from the eyes, in metres; 0.7 by default."""
    errors: Annotated[float | None, tyro.conf.arg(help_behavior_hint="", metavar="FLOAT")] = None
    """Scale of a simulated head's deviations from its model: 1 for the spreads of the article's
    head before calibration; 0 by default."""

    def run(self) -> int:
        """Run the command."""
        require_modules("robot", "mcap")
        from vergence.calibration.head.collect import CollectOptions, collect
        from vergence.calibration.head.recording import HEAD_IDENTITY
        from vergence.calibration.observations import parse_board

        options = CollectOptions(
            poses=self.poses, frames=self.frames, seed=self.seed, until=self.until, moved=self.moved
        )
        target = parse_board(self.target, accept_single_tag=True)
        looker = self._robot(target) if self.plant == "hardware" else self._simulated(target)
        facts = {"command": "collect", "plant": self.plant, "seed": str(self.seed)}
        facts[HEAD_IDENTITY] = self.plant if self.plant == "hardware" else self._looks(looker.head)
        try:
            with closing(looker), progress_bar("collect") as report:
                recording = collect(
                    looker, self.folder, options, facts, progress=report,
                    on_evaluation=lambda result: print_to_stderr(_evaluated(result, looker.head)),
                )  # fmt: skip
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"{self.folder} keeps the frames that it has; the same command goes on"
            ) from None
        self._conclude(recording, looker.head)
        return 0

    def _robot(self, target: "PlanarTarget") -> "Looker":
        for name, value in (("distance", self.distance), ("errors", self.errors)):
            if value is not None:
                raise ConfigurationError(f"{name}: expected a simulated head, got --plant hardware")
        if self.config is None:
            raise ConfigurationError("config: expected the file that describes the robot, got none")
        from vergence.models.head_file import load_head

        try:
            make = import_module(_ROBOT_LOOKER_MODULE).RobotLooker
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"plant: expected one that this installation has, got hardware: {error}"
            ) from error
        interrupts.raise_on_termination()
        looker: Looker = make(self.config, target)
        if self.head is not None and load_head(self.head).digest != looker.head.digest:
            looker.close()
            raise ConfigurationError(
                f"head: expected that of {self.config}, {looker.head.name}, got {self.head}"
            )
        return looker

    def _simulated(self, target: "PlanarTarget") -> "Looker":
        if self.config is not None:
            raise ConfigurationError(f"config: expected --plant hardware, got --plant {self.plant}")
        distance_m = _DEFAULT_DISTANCE_M if self.distance is None else self.distance
        errors = 0.0 if self.errors is None else self.errors
        if not _NEAREST_M <= distance_m <= _FARTHEST_M:
            raise ConfigurationError(
                f"distance: expected {_NEAREST_M:g} to {_FARTHEST_M:g} metres, got {distance_m:g}"
            )
        if not 0.0 <= errors <= _MOST_ERROR_SCALE:
            raise ConfigurationError(f"errors: expected 0 to {_MOST_ERROR_SCALE:g}, got {errors:g}")
        import numpy as np

        from vergence.calibration.head.simulated import SimulatedLooker, board_ahead
        from vergence.eval.trials.twin_errors import TWIN_SPREADS
        from vergence.models.head_file import load_head

        head = load_head(self.head or _DEFAULT_HEAD)
        # runs with one seed have the same head but different noise
        true = head.perturbed(np.random.default_rng(self.seed), TWIN_SPREADS.scaled(errors))
        runs = len(list(self.folder.glob("*.mcap")))
        return SimulatedLooker(
            head, target, board_ahead(head, target, distance_m),
            np.random.default_rng([self.seed, runs, 1]), true_head=true,
            drawn=self.plant == "rendered",
        )  # fmt: skip

    def _looks(self, head: "HeadModel") -> str:
        """Label that tells this simulated head from others of the same file."""
        errors = self.errors or 0.0
        return f"{self.plant} {head.digest[:16]} {f'{errors:g} {self.seed}' if errors else ''}"

    def _conclude(self, recording: "CollectedRecording", head: "HeadModel") -> None:
        """Print a summary of the recording, advice, and the next command."""
        from vergence.calibration.head.collect import advise_recording
        from vergence.calibration.head.judge import refuse_few_poses

        frames = recording.frames()
        placements = int(frames.placement.max()) + 1
        print(
            f"{len(frames.time_s)} frames of {int(frames.pose.max()) + 1} poses, {placements} "
            f"placement{'' if placements == 1 else 's'} of the board"
        )
        if recording.preview is not None:
            print(f"depth will be known to {_depth(recording.preview)}")
        if recording.looks_without_board:
            print_to_stderr(f"{recording.looks_without_board} looks without the board, left out")
        for line in advise_recording(head, recording, frames):
            print_to_stderr(line)
        try:
            refuse_few_poses(frames)
        except ConfigurationError as error:
            print_to_stderr(str(error))
            return
        names = chain(["calibrated.toml"], (f"calibrated-{n}.toml" for n in count(2)))
        out = next(name for name in names if not Path(name).exists())
        named = _head_of(self.config) if self.config is not None else self.head or _DEFAULT_HEAD
        words = ["calibrate", "head", str(self.folder), "--head", named, "--out", out]
        print(f"next: vergence {shlex.join(words)}")


def _evaluated(recording: "CollectedRecording", head: "HeadModel") -> str:
    """Line on the accuracy of depth and the coverage of the images so far."""
    from vergence.calibration.head.collect import image_coverage_percent

    known = "not enough for a head yet"
    if recording.preview is not None:
        known = f"depth known to {_depth(recording.preview)}"
    left, right = image_coverage_percent(head, recording.frames())
    return f"{recording.poses} poses: {known}; {left:.0f} and {right:.0f} % of both images covered"


def _depth(preview: "CalibrationPreview") -> str:
    from vergence.calibration.head.calibrate import DEPTHS_M

    return " and ".join(
        f"{percent:.2g} % at {depth_m:g} m"
        for percent, depth_m in zip(preview.depth_percent, DEPTHS_M, strict=True)
    )


def _head_of(config: Path) -> str:
    """Head named in a robot's configuration: a preset's name or a path."""
    name = str(tomllib.loads(config.read_text(encoding="utf-8-sig"))["head"])
    return str(config.parent / name) if name.endswith(".toml") else name

"""The Gymnasium environment of the gaze task on a real head."""

import os
import weakref
from typing import Any, Final

from vergence.envs.gaze import GazeEnv
from vergence.errors import ConfigurationError
from vergence.hardware.config import HardwareConfig, load_hardware, refuse_other_head
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.recording.writer import LogWriter

EPISODE_S: Final = 2.0
"""Length of an episode, s: that of `vergence/Gaze-v0` with its default head (chosen)."""


class GazeHardwareEnv(GazeEnv):
    """Gaze task on a real head: two camera eyes turn until both look straight at a target.

    Action space, observation space and rewards are those of `vergence.envs.gaze.GazeEnv`, so a
    policy runs here as it does in simulation. `reset` drives the joints to the start of the trial;
    the time of an episode begins with its first step. Call `close`, or use the environment in a
    `with` statement: this brings the servos to rest.

    ## Arguments
    `config`: the path of the file that describes the robot, see `vergence.hardware.config`. `log`:
    the path of a new file to log to, see `vergence.recording`; None for no log.
    `head`: None for the head of that file; another one is refused. `duration_s`: seconds after
    which an episode is truncated, 2 by default; None for never. `target`, `info`, `render_mode`: as
    in `GazeEnv`. On a robot `target` sets only the start posture, as the real target stands in the
    world; before an emulated head it also places the target.

    ## Version history
    * v0: the first.
    """

    def __init__(
        self,
        *,
        config: str | os.PathLike[str] | HardwareConfig | None = None,
        head: str | HeadModel | None = None,
        duration_s: float | None = EPISODE_S,
        log: str | os.PathLike[str] | None = None,
        **options: Any,
    ) -> None:
        if config is None:
            raise ConfigurationError(
                "config: expected the path of a TOML file that describes a robot, got none"
            )
        for name in ("plant", "plant_options"):
            if name in options:
                raise ConfigurationError(f"{name}: expected none with config, got one")
        hardware = config if isinstance(config, HardwareConfig) else load_hardware(config)
        if head is not None:
            refuse_other_head(hardware, head if isinstance(head, HeadModel) else load_head(head))
        self._log = None
        if log is not None:
            self._log = LogWriter(log, head=hardware.head, config=hardware.text)
            # finalizers run in reverse order: registered before the plant's, this one runs after it
            weakref.finalize(self, self._log.close)
        try:
            super().__init__(
                duration_s=duration_s,
                head=hardware.head,
                plant="hardware",
                plant_options={"config": hardware, "log": self._log},
                **options,
            )
        except BaseException:
            self._close_log()
            raise

    def close(self) -> None:
        """Bring the servos to rest, release the robot, and end the log."""
        super().close()
        self._close_log()

    def _close_log(self) -> None:
        if self._log is not None:
            self._log.close()

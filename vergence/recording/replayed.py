"""A plant that replays a log: policies run again on its readings, and nothing moves."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from vergence.envs.plant import Plant
from vergence.envs.reading import Image, Reading, Truth
from vergence.envs.streams import IntArray
from vergence.errors import ConfigurationError, HardwareError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording.log import LoggedTrial

REPLAYED_ENTRY_POINT: Final = f"{__name__}:ReplayedPlant"
"""Entry point of the plant."""


class ReplayedPlant(Plant):
    """One head with a log's readings; each reset begins the log's next trial.

    Args:
        head: the model that the controller uses.
        num: number of heads, 1.
        trials: the logged trials.

    Attributes:
        commands: list of the velocities, (7,) rad/s, that the policy has commanded in the current
            trial.

    Raises:
        ConfigurationError: num is not 1.
    """

    max_num = 1

    def __init__(self, head: HeadModel, num: int = 1, *, trials: Sequence[LoggedTrial]) -> None:
        if num != 1:
            raise ConfigurationError(f"num: expected 1, as a log is of one head, got {num}")
        self.head, self.num = head, num
        self.commands: list[FloatArray] = []
        self._trials = list(trials)
        self._place, self._step = -1, 0

    def reset(self, ids: IntArray, positions: FloatArray) -> Reading:
        """Begin the next trial; the positions are the log's, the arguments are ignored.

        Raises:
            HardwareError: the log has no further trial.
        """
        if self._place + 1 >= len(self._trials):
            raise HardwareError(f"the log has no more than {len(self._trials)} trials")
        self._place += 1
        self.commands, self._step = [], 0
        return self._reading()

    def step(self, command: FloatArray) -> Reading:
        """Keep the command, and return the log's next reading.

        Raises:
            HardwareError: the trial has no further reading.
        """
        if self._step >= self._trial.steps:
            raise HardwareError(f"the trial has no more than {self._trial.steps} control periods")
        self.commands.append(np.array(command[0]))
        self._step += 1
        return self._reading()

    @property
    def _trial(self) -> LoggedTrial:
        return self._trials[self._place]

    def _reading(self) -> Reading:
        return Reading._make(values[self._step] for values in self._trial.readings)

    def frames(self, place: int = 0) -> tuple[Image, Image] | None:
        """See `Plant.frames`."""
        return self._trial.frames(self._step)

    def truth(self) -> Truth | None:
        """Logged ground truth of the present; None if none is logged."""
        if self._trial.truths is None:
            return None
        return Truth._make(values[self._step] for values in self._trial.truths)

    def close(self) -> None:
        """Do nothing: no resource is held."""

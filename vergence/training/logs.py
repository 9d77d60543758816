"""What TensorBoard is shown of a run."""

import threading
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger
from torch.utils.tensorboard.writer import SummaryWriter


class TensorBoardWriter(KVWriter):
    """Scalars to TensorBoard; a run that goes on hides what was written after its checkpoint.

    Args:
        folder: where its files belong.
        purge_step: the step from which on earlier entries are hidden; None for none.
    """

    def __init__(self, folder: Path, purge_step: int | None) -> None:
        self._excepthook = threading.excepthook
        threading.excepthook = self._unless_raised_here
        self._writer = SummaryWriter(str(folder), purge_step=purge_step)

    def _unless_raised_here(self, args: threading.ExceptHookArgs) -> None:
        """Say nothing of a file that cannot be written: the next `write` raises the error."""
        if not isinstance(args.exc_value, OSError):
            self._excepthook(args)

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0
    ) -> None:
        """Write numbers; see `stable_baselines3.common.logger.KVWriter`."""
        for key, value in key_values.items():
            if isinstance(value, int | float) and "tensorboard" not in (key_excluded[key] or ()):
                self._writer.add_scalar(key, value, step)
        self._writer.flush()

    def close(self) -> None:
        """Write what is left."""
        try:
            self._writer.close()
        finally:
            threading.excepthook = self._excepthook


def make_logger(folder: Path, purge_step: int | None) -> Logger:
    """SB3's logger, writing to TensorBoard alone."""
    return Logger(folder=None, output_formats=[TensorBoardWriter(folder, purge_step)])

"""Log a run to TensorBoard."""

import threading
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger
from torch.utils.tensorboard.writer import SummaryWriter


class TensorBoardWriter(KVWriter):
    """Writes scalars to TensorBoard; a resumed run hides entries from after its checkpoint.

    Args:
        folder: folder of the event files.
        purge_step: step from which on existing entries are hidden; None to hide none.
    """

    def __init__(self, folder: Path, purge_step: int | None) -> None:
        self._excepthook = threading.excepthook
        threading.excepthook = self._unless_raised_here
        self._writer = SummaryWriter(str(folder), purge_step=purge_step)

    def _unless_raised_here(self, args: threading.ExceptHookArgs) -> None:
        """Ignore errors of the writer's thread on a file: the next `write` raises them."""
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
        """Write pending entries and close the files."""
        try:
            self._writer.close()
        finally:
            threading.excepthook = self._excepthook


def make_logger(folder: Path, purge_step: int | None) -> Logger:
    """Make an SB3 logger that writes only to TensorBoard."""
    return Logger(folder=None, output_formats=[TensorBoardWriter(folder, purge_step)])

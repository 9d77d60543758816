"""Clicks of a viewer in the images of a running robot: a small file beside its log."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vergence.files import write_atomic
from vergence.models.parts import FloatArray


class Click(NamedTuple):
    """A click in an eye's image."""

    eye: int
    """0 for left, 1 for right."""
    pixel: FloatArray
    """(2,) raw pixel (u, v)."""
    exposed_s: float
    """Time of the image's exposure, s of the robot's clock."""


def _file_beside(log: Path) -> Path:
    return log.with_suffix(".click")


def write_click(log: Path, click: Click) -> None:
    """Leave a click for the robot that writes a log.

    Raises:
        OSError: the folder cannot be written to.
    """
    u, v = click.pixel.tolist()
    write_atomic(_file_beside(log), json.dumps([click.eye, u, v, click.exposed_s]))


class ClickReader:
    """Reads the newest click beside a log, without ever waiting; remove it with `close`."""

    def __init__(self, log: Path) -> None:
        self._file = _file_beside(log)
        self.close()
        self._seen: tuple[int, int] | None = None

    def poll(self) -> Click | None:
        """The newest click; None if there is no new one."""
        try:
            stat = self._file.stat()
            if (stat.st_ino, stat.st_mtime_ns) == self._seen:
                return None
            self._seen = stat.st_ino, stat.st_mtime_ns
            eye, u, v, exposed_s = json.loads(self._file.read_text())
            return Click(int(eye) & 1, np.array([float(u), float(v)]), float(exposed_s))
        except (OSError, ValueError, TypeError):  # none yet, or not written by a viewer
            return None

    def close(self) -> None:
        """Remove the file."""
        self._file.unlink(missing_ok=True)

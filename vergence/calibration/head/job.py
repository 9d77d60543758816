"""One recording's calibration as a job: by itself, in a process of its own, or on a cluster."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vergence.calibration.head.calibrate_head import calibrate_head
from vergence.calibration.head.files import head_text
from vergence.calibration.head.observability import Unseen, unseen
from vergence.calibration.head.recording import Recorded
from vergence.calibration.head.report import document, write_run
from vergence.errors import ConfigurationError
from vergence.models.head import HeadModel


@dataclass(frozen=True, kw_only=True)
class HeadOutcome:
    """What came of a recording."""

    text: str
    """The head file; empty where there is no head."""
    document: Mapping[str, Any]
    """The result as plain values."""
    unseen: tuple[Unseen, ...]
    """What the recording does not tell."""
    files: Mapping[str, bytes]
    """The run folder's files by name."""
    refused: str
    """Why there is no head; empty where there is one."""


@dataclass(frozen=True, kw_only=True)
class HeadJob:
    """The calibration of a head from one recording.

    Attributes:
        head: as its file has it.
        recorded: what it saw.
        cameras: whether the cameras may be otherwise than the file says, too.
        terms: see `calibrate_head`.
        name: of the calibrated head.
        file: name of the file that is to be written.
        path: of the recording.
    """

    head: HeadModel
    recorded: Recorded
    cameras: bool
    terms: tuple[str, ...]
    name: str
    file: str
    path: str

    def __call__(self, progress: Callable[[float], None] | None = None) -> HeadOutcome:
        """Calibrate.

        Args:
            progress: called with the fraction done.
        """
        recorded = self.recorded
        try:
            found = calibrate_head(
                self.head,
                recorded.frames,
                cameras=self.cameras,
                terms=self.terms,
                progress=progress,
            )
        except ConfigurationError as error:
            return HeadOutcome(text="", document={}, unseen=(), files={}, refused=str(error))
        text = head_text(found, recorded.sha256, self.name)
        dark = unseen(found.solution)
        provenance = {
            "recording": self.path,
            "files": ", ".join(recorded.files),
            "target": str(recorded.frames.target),
            "sha256": recorded.sha256,
        }
        with tempfile.TemporaryDirectory(prefix="vergence-") as folder:
            write_run(Path(folder), found, dark, text, self.file, provenance)
            files = {each.name: each.read_bytes() for each in Path(folder).iterdir()}
        told = {
            **document(found, dark),
            "recording": self.path,
            "remarks": [*recorded.remarks, *found.remarks],
            "not_read": list(recorded.failures),
        }
        return HeadOutcome(text=text, document=told, unseen=dark, files=files, refused="")

"""Options that several commands have."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

if TYPE_CHECKING:
    from vergence.eval.jobs import Mapper, Progress

T = TypeVar("T")
Flat = Annotated[T, tyro.conf.arg(name="")]
"""A dataclass whose fields are options of the command that holds it."""


@dataclass(frozen=True, kw_only=True)
class Machines:
    """Where a command's jobs run."""

    workers: int | None = None
    """Processes on this machine; one per processor by default."""
    cluster: str | None = None
    """Address of a Ray cluster to run on, HOST:PORT (needs the extra cluster)."""

    def open_mapper(self, progress: "Progress | None" = None) -> "AbstractContextManager[Mapper]":
        """See `vergence.eval.jobs.open_mapper`."""
        from vergence.eval.jobs import open_mapper

        return open_mapper(self.workers, self.cluster, progress)


def dated_folder(what: str) -> Path:
    """The run folder of a command that was given none."""
    return Path("runs") / f"{what}-{datetime.now():%Y%m%d-%H%M%S-%f}"

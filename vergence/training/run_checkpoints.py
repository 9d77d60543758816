"""The checkpoints of a run folder: the best and the last, bound to the run's choices and head."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from vergence.errors import ConfigurationError
from vergence.eval.reporting.runs import plain
from vergence.files import whole_files
from vergence.models.head import HeadModel
from vergence.training.checkpoint import checkpoint_bytes, read_checkpoint, write_checkpoint
from vergence.training.config import TrainConfig

CHECKPOINTS: Final = ("best", "last")
SURROUNDINGS: Final = "surroundings"
"""What the last checkpoint holds beside what the best one does: what it was in the midst of."""
_MAY_CHANGE: Final = ("steps",)
"""Choices that may change when a run goes on."""


@dataclass(frozen=True)
class RunCheckpoints:
    """The checkpoints of one run.

    `last` is what the run goes on from, `best` the network of its best evaluation. Each says which
    run it is of, and is refused in another.
    """

    run: Path
    """The run folder."""
    config: TrainConfig
    """What `config.toml` says."""
    head: HeadModel
    """What `head.toml` says."""

    def path(self, which: str) -> Path:
        """The file of a checkpoint."""
        return self.run / "checkpoints" / f"{which}.pt"

    def read(self, which: str) -> dict[str, Any]:
        """The content of a checkpoint.

        Args:
            which: `best` or `last`.

        Raises:
            ConfigurationError: there is none, it is damaged, or it is that of another run.
        """
        if which not in CHECKPOINTS:
            raise ConfigurationError(f"checkpoint: expected best or last, got {which!r}")
        path = self.path(which)
        content = read_checkpoint(path)
        recorded = content.get("run", {})
        if recorded.get("head") != self.head.digest:
            raise ConfigurationError(
                f"head.toml: expected the head that {path} was trained on (digest "
                f"{str(recorded.get('head'))[:12]}), got another ({self.head.digest[:12]})"
            )
        changes = _changes(recorded.get("config", {}), plain(dataclasses.asdict(self.config)))
        if changes:
            raise ConfigurationError(
                f"config.toml: expected the choices that {path} was trained with, "
                f"got {', '.join(changes)}"
            )
        return content

    def write(
        self, content: Mapping[str, Any], surroundings: Mapping[str, Any], best: bool
    ) -> None:
        """Write the last checkpoint, and the best one if this is it.

        Args:
            content: what both hold.
            surroundings: what the last one holds beside that, to go on from.
            best: whether this is the best evaluation so far.
        """
        marked = {**content, "run": self._run()}
        full = {**marked, SURROUNDINGS: surroundings}
        folder = self.path("last").parent
        folder.mkdir(exist_ok=True)
        # the last first: where a kill comes between, `latest` makes the best one from it
        with whole_files(folder, last="best.pt") as beside:
            (beside / "last.pt").write_bytes(checkpoint_bytes(full))
            if best:
                (beside / "best.pt").write_bytes(checkpoint_bytes(marked))

    def latest(self) -> dict[str, Any] | None:
        """The last checkpoint, with the best one beside it; None where nothing was saved yet.

        Raises:
            ConfigurationError: either is missing, damaged or that of another run.
        """
        last, best = self.path("last"), self.path("best")
        if not last.exists():
            left = [path for path in (best, self.run / "curve.csv") if _has_progress(path)]
            if left:
                raise ConfigurationError(
                    f"resume: expected {last}, which a run goes on from, got a run that lost it: "
                    f"there is {left[0]} (put last.pt back, or export the best network by vergence "
                    "export bundle and begin a new run)"
                )
            return None
        content = self.read("last")
        kept = next(row["step"] for row in reversed(content["curve"]) if row["best"])
        if best.exists() and self.read("best")["steps"] == kept:
            return content
        if content["steps"] != kept:
            raise ConfigurationError(
                f"resume: expected {best}, of {kept} steps, beside last.pt, "
                f"got {'another' if best.exists() else 'no such file'} (put it back)"
            )
        write_checkpoint(best, {k: v for k, v in content.items() if k != SURROUNDINGS})
        return content

    def _run(self) -> dict[str, Any]:
        return {"config": plain(dataclasses.asdict(self.config)), "head": self.head.digest}


def _has_progress(path: Path) -> bool:
    """Whether a file is there, of a table whether it has rows."""
    if not path.exists():
        return False
    return path.suffix != ".csv" or len(path.read_bytes().splitlines()) > 1


def _changes(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    """What differs, field by field."""
    changes = []
    for name in sorted(set(before) | set(now)):
        old, new = before.get(name), now.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            changes += _changes(old, new, f"{prefix}{name}.")
        elif old != new and name not in _MAY_CHANGE:
            changes.append(f"{prefix}{name} = {new!r} (was {old!r})")
    return changes

"""The best and the last checkpoint of a run folder, bound to its configuration and head."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from vergence.errors import ConfigurationError
from vergence.files import atomic_files
from vergence.models.head import HeadModel
from vergence.reporting.runs import toml_value
from vergence.training.checkpoint import checkpoint_bytes, read_checkpoint, write_checkpoint
from vergence.training.config import TrainConfig

CHECKPOINT_NAMES: Final = ("best", "last")
RUNNING_EPISODES_KEY: Final = "surroundings"
"""Key of the state of running episodes, which only the last checkpoint holds."""
_CHANGEABLE_FIELDS: Final = ("steps",)
"""Fields of the configuration that may change if a run is resumed."""


@dataclass(frozen=True)
class RunCheckpoints:
    """The checkpoints of one run.

    A run is resumed from `last`; `best` holds the network of its best evaluation. Each records the
    configuration and head of its run; reading it for another run raises an error.
    """

    run: Path
    """The run folder."""
    config: TrainConfig
    """Configuration in `config.toml`."""
    head: HeadModel
    """Head in `head.toml`."""

    def path(self, checkpoint: str) -> Path:
        """Path of a checkpoint."""
        return self.run / "checkpoints" / f"{checkpoint}.pt"

    def read(self, checkpoint: str) -> dict[str, Any]:
        """Read the content of a checkpoint.

        Args:
            checkpoint: `best` or `last`.

        Raises:
            ConfigurationError: the checkpoint is missing, damaged, or of another run.
        """
        if checkpoint not in CHECKPOINT_NAMES:
            raise ConfigurationError(f"checkpoint: expected best or last, got {checkpoint!r}")
        path = self.path(checkpoint)
        content = read_checkpoint(path)
        recorded = content.get("run", {})
        if recorded.get("head") != self.head.digest:
            raise ConfigurationError(
                f"head.toml: expected the head that {path} was trained on (digest "
                f"{str(recorded.get('head'))[:12]}), got another ({self.head.digest[:12]})"
            )
        changes = _changes(recorded.get("config", {}), toml_value(dataclasses.asdict(self.config)))
        if changes:
            raise ConfigurationError(
                f"config.toml: expected the choices that {path} was trained with, "
                f"got {', '.join(changes)}"
            )
        return content

    def write(
        self, content: Mapping[str, Any], running_episodes: Mapping[str, Any], best: bool
    ) -> None:
        """Write the last checkpoint, and also the best one if `best`.

        Args:
            content: content of both.
            running_episodes: state of the running episodes, only for the last one.
            best: True if this is the best evaluation so far.
        """
        marked = {**content, "run": self._run()}
        full = {**marked, RUNNING_EPISODES_KEY: running_episodes}
        folder = self.path("last").parent
        folder.mkdir(exist_ok=True)
        # last.pt comes first: if the process is killed in between, `latest` makes best.pt from it
        with atomic_files(folder, moved_last="best.pt") as beside:
            (beside / "last.pt").write_bytes(checkpoint_bytes(full))
            if best:
                (beside / "best.pt").write_bytes(checkpoint_bytes(marked))

    def latest(self) -> dict[str, Any] | None:
        """Read the last checkpoint, and make sure of the best one; None if nothing was saved yet.

        Raises:
            ConfigurationError: either is missing, damaged or of another run.
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
        write_checkpoint(best, {k: v for k, v in content.items() if k != RUNNING_EPISODES_KEY})
        return content

    def _run(self) -> dict[str, Any]:
        return {"config": toml_value(dataclasses.asdict(self.config)), "head": self.head.digest}


def _has_progress(path: Path) -> bool:
    """True if a file exists and, for a table, has rows."""
    if not path.exists():
        return False
    return path.suffix != ".csv" or len(path.read_bytes().splitlines()) > 1


def _changes(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Differences between two configurations, field by field."""
    changes = []
    for name in sorted(set(before) | set(now)):
        old, new = before.get(name), now.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            changes += _changes(old, new, f"{prefix}{name}.")
        elif old != new and name not in _CHANGEABLE_FIELDS:
            changes.append(f"{prefix}{name} = {new!r} (was {old!r})")
    return changes

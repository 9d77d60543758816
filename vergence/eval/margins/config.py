"""Configuration of margins; on the command line, the options of `vergence evaluate`."""

from dataclasses import dataclass
from typing import ClassVar

from vergence.eval.comparison.config import EvaluateConfig


@dataclass(frozen=True, kw_only=True)
class MarginsConfig(EvaluateConfig):
    """The margins to measure; `episodes` is the number of trials at each value, 200 by default."""

    imperfections: tuple[str, ...] = ()
    """Imperfections to vary, by the names of `vergence.eval.margins.ranges.IMPERFECTION_RANGES`;
    all by default."""

    default_trials: ClassVar[int] = 200

"""Configuration of tuning, also the options of `vergence tune`; the options and their ranges."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import tyro

from vergence.errors import ConfigurationError, UnknownNameError

LEARNED: Final = ("gain-schedule", "policy")
"""Kinds of training, whose recipes can be tuned like the options of controllers."""


@dataclass(frozen=True, kw_only=True)
class TuneConfig:
    """The options to tune, and the search."""

    controller: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER")]
    """Controller (see `vergence info`), or gain-schedule or policy to tune their training."""
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "workspace"
    """Scenario whose training trials judge each point (see `vergence info`)."""
    trials: int = 100
    """Total number of points to try, including those of earlier calls; ignored for a grid."""
    episodes: int = 400
    """Number of the scenario's trials that judge each point."""
    grid: bool = False
    """Try every point of the search's grid; the default for a single option with a step."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = 300_000
    """Control steps of each training; only for gain-schedule and policy."""
    head: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="HEAD")] = None
    """Head: a preset's name or the path of a TOML file; the scenario's by default."""
    plant: Annotated[str, tyro.conf.arg(metavar="PLANT")] = "kinematic"
    """Plant that moves the heads."""
    seed: int = 0
    """Seed of the trials and of the search."""
    storage: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="FILE|URL")] = None
    """Storage of the study: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE, which
    several machines may share; study.db in the run folder by default."""
    study: Annotated[str | None, tyro.conf.arg(help_behavior_hint="", metavar="NAME")] = None
    """Name of the study; CONTROLLER-SCENARIO by default."""

    @property
    def learned(self) -> bool:
        """True if a kind of training is tuned."""
        return self.controller in LEARNED

    @property
    def name(self) -> str:
        """The study's name."""
        return self.study or f"{self.controller}-{self.scenario}"

    def storage_in(self, folder: Path) -> str:
        """Storage of the study of a run."""
        return self.storage or str(folder / "study.db")


Options = dict[str, float]
"""Values by option."""


class SearchRange(NamedTuple):
    """Search range of an option."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"
    step: float | None = None
    """Step of the grid, which starts at `low`; None for a continuous search."""

    def points(self) -> list[float]:
        """The grid's values, as exact decimals; empty without a step."""
        if self.step is None:
            return []
        count = round((self.high - self.low) / self.step) + 1
        return [round(self.low + i * self.step, 10) for i in range(count)]


SEARCH_SPACES: Final[dict[str, dict[str, SearchRange]]] = {
    # overshoot begins at 4.1 with nominal timing; moving targets need up to 17, where the loop
    # oscillates and is almost unstable
    "ibvs": {"gain": SearchRange(0.5, 20.0, "linear", 0.05)},
    # lambda_zero = lambda_inf is a fixed gain, so the best options are at least as good as that
    "adaptive": {
        "lambda_zero": SearchRange(1.0, 12.0, "linear", 0.05),
        "lambda_inf": SearchRange(0.5, 12.0, "linear", 0.05),
        "slope_zero": SearchRange(0.5, 500.0, "log"),
    },
    "pid": {
        "kp": SearchRange(1.0, 12.0, "linear", 0.05),
        "ki": SearchRange(0.001, 2.0, "log"),
        "kd": SearchRange(0.0, 0.6),
        "filter_s": SearchRange(0.002, 0.06, "log"),
    },
    # error_px and rate_px_s scale the region of the rules: near the target, or on the way to it
    "fuzzy": {
        "kp": SearchRange(1.0, 12.0, "linear", 0.05),
        "ki": SearchRange(0.001, 2.0, "log"),
        "kd": SearchRange(0.0, 0.6),
        "span_p": SearchRange(0.0, 1.0),
        "span_i": SearchRange(0.0, 1.0),
        "span_d": SearchRange(0.0, 1.0),
        "error_px": SearchRange(3.0, 600.0, "log"),
        "rate_px_s": SearchRange(20.0, 3000.0, "log"),
        "filter_s": SearchRange(0.002, 0.06, "log"),
    },
    "delay-compensated": {"gain": SearchRange(2.0, 60.0, "log")},
    "state-feedback": {"gain": SearchRange(5.0, 100.0, "log"), "damping": SearchRange(0.0, 1.5)},
}
"""The options that `vergence tune` varies, by controller."""


def search_space(controller: str) -> dict[str, SearchRange]:
    """Search space of a controller's options; an error if there is nothing to tune."""
    from vergence.controllers.controller import CONTROLLERS
    from vergence.controllers.tuned import name_in_tuned_table

    name = name_in_tuned_table(controller)
    if name not in SEARCH_SPACES:
        known = [*sorted(SEARCH_SPACES), *LEARNED]
        if name in CONTROLLERS:
            raise ConfigurationError(
                f"controller to tune: expected one of {', '.join(known)}, got {controller!r}, "
                "which runs in every scenario with the same options"
            )
        raise UnknownNameError("controller to tune", controller, known)
    return SEARCH_SPACES[name]


def default_point(controller: str, search_ranges: Mapping[str, SearchRange]) -> Options | None:
    """The controller's defaults; None if one is missing or outside its search range."""
    from vergence.controllers.controller import CONTROLLERS
    from vergence.controllers.tuned import name_in_tuned_table

    module, _, attribute = CONTROLLERS.get(name_in_tuned_table(controller), "").partition(":")
    if not module:
        return None
    known = inspect.signature(getattr(import_module(module), attribute)).parameters
    point = {}
    for name, span in search_ranges.items():
        default = known[name].default if name in known else None
        if not isinstance(default, int | float) or not span.low <= default <= span.high:
            return None
        point[name] = float(default)
    return point


def has_single_stepped_option(search_ranges: Mapping[str, SearchRange]) -> bool:
    """True if a search is small enough to try every point: a single option with a step."""
    return len(search_ranges) == 1 and all(span.step is not None for span in search_ranges.values())

"""Scenarios: named tasks on which controllers are compared.

A scenario is an assignment, which simulated heads and robots share (a target, a duration and a band
of settling), with its simulation: the head, the plants, and the conditions that vary from trial to
trial and are hidden from the controller. Its seeds are split into training, validation and test
seeds, so far apart that the seeds of a vector of environments never reach another split.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Final

from vergence.entry_points import is_entry_point
from vergence.envs.plant import Simulation
from vergence.envs.plants.conditions import Variation
from vergence.envs.task import GazeTask
from vergence.errors import (
    ConfigurationError,
    UnknownNameError,
    UnreachableTargetError,
    did_you_mean,
)
from vergence.eval.trials.loops import (
    DESK_LOOP,
    DYNAMIXEL_RESOLUTIONS,
    HARDWARE_LOOP,
    LATEST_ONSET_S,
    TICK_RAD_S,
    WEBCAM_LOOP,
)
from vergence.eval.trials.twin_errors import TWIN_ERRORS
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head

SPLITS: Final = ("train", "validation", "test")
"""Purposes of trials, each with seeds of its own."""
_SPLIT_SEED_STRIDE: Final = 2**40
"""Distance between the first seeds of two splits (numerical)."""
_VECTOR_SEED_STRIDE: Final = 2**20
"""Distance between two seeds of a split: the greatest size of a vector (numerical)."""


@dataclass(frozen=True, kw_only=True)
class BaseScenario:
    """Target, duration and settling band of trials, which simulated heads and robots share."""

    name: str
    description: str
    """Description of a trial, one line."""
    target: Mapping[str, Any]
    """The target, see `vergence.envs.targets.make_target`. A robot that looks at the world
    ignores it, see `vergence.eval.robot.stage`."""
    duration_s: float
    """Duration of a trial, s."""
    band_px: float = 1.0
    """Leading band: the one to which settling is judged, px."""
    target_moves: bool = False
    """True if the target keeps moving: tracking is evaluated, not settling."""
    catch_up_s: float = 0.0
    """Time after the onset that does not count in the tracking of a moving target, s."""

    def seed(self, split: str, seed: int = 0) -> int:
        """The seed of the trials of a split.

        Args:
            split: one of `SPLITS`.
            seed: index of the seed within the split, 0 to 2**20 - 1. A vector of up to 2**20
                environments, of which environment i has the returned seed + i, never overlaps with
                another seed's vector.

        Raises:
            UnknownNameError: there is no such split.
            ConfigurationError: the seed is out of range.
        """
        if split not in SPLITS:
            raise UnknownNameError("split", split, list(SPLITS))
        if not 0 <= seed < _SPLIT_SEED_STRIDE // _VECTOR_SEED_STRIDE:
            raise ConfigurationError(f"seed: expected 0 to 2**20 - 1, got {seed}")
        return (1 + SPLITS.index(split)) * _SPLIT_SEED_STRIDE + seed * _VECTOR_SEED_STRIDE


@dataclass(frozen=True, kw_only=True)
class Scenario(BaseScenario):
    """An assignment and its simulation."""

    head: str = "simulated"
    """Preset of the head that the controller knows."""
    head_overrides: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Overrides of the preset's values, see `HeadModel.replace`."""
    plants: tuple[str, ...] = ("kinematic", "mujoco")
    """Names of the plants that can move the head."""
    variation: Variation | None = None
    """Ranges of the conditions that each trial draws, hidden from the controller."""

    def model(self) -> HeadModel:
        """The head that the controller knows."""
        return load_head(self.head).replace(**self.head_overrides)

    @property
    def steps(self) -> int:
        """Number of control periods of a trial."""
        return round(self.duration_s * self.model().timing.control_rate_hz)

    def env_options(
        self, plant: str = "kinematic", head: str | HeadModel | None = None
    ) -> dict[str, Any]:
        """Keyword arguments of `GazeTask`, `GazeVectorEnv` and `gymnasium.make`.

        Args:
            plant: one of `plants`, or `module:class` of a custom plant.
            head: a head other than the scenario's; None for the scenario's.

        Raises:
            ConfigurationError: the scenario does not run on that plant.
        """
        if plant not in self.plants and not is_entry_point(plant):
            raise ConfigurationError(
                f"plant: expected one of {', '.join(self.plants)} or module:class for the scenario "
                f"{self.name!r}, got {plant!r}{did_you_mean(plant, self.plants)}"
            )
        return {
            "head": (self.model() if self.head_overrides else self.head) if head is None else head,
            "plant": plant,
            "target": dict(self.target),
            "variation": self.variation,
        }

    def task(
        self, num: int = 1, plant: str = "kinematic", head: str | HeadModel | None = None
    ) -> GazeTask:
        """Make a task that runs this scenario's trials, see `env_options`.

        Args:
            num: number of heads in the batch.
            plant: one of `plants`, or `module:class` of a custom simulated plant.
            head: a head other than the scenario's; None for the scenario's.

        Raises:
            ConfigurationError: the scenario does not run on that plant, or the head cannot look at
                its target.
        """
        options = self.env_options(plant, head)
        with explaining_target_errors(self.name):
            task = GazeTask(num, **options)
        if not isinstance(task.plant, Simulation):
            task.close()
            raise ConfigurationError(
                f"plant: expected a simulated one for the scenario {self.name!r}, which draws its "
                f"targets, got {plant!r}, which looks at the world"
            )
        return task


@contextmanager
def explaining_target_errors(scenario: str) -> Iterator[None]:
    """Add the scenario's name and a remedy to the error for a target that a head cannot look at.

    Args:
        scenario: the scenario's name.

    Raises:
        UnreachableTargetError: the head cannot look at the scenario's target.
    """
    try:
        yield
    except UnreachableTargetError as error:
        raise UnreachableTargetError(
            f"scenario {scenario}: {error}; choose another scenario, or a head whose joints "
            "and images reach there"
        ) from error


_ALL_PLANTS: Final = ("kinematic", "mujoco", "rendered")
_SCENARIOS = (
    Scenario(
        name="hardware",
        description="the workspace through a robot's loop: late, jittering, noisy, with play "
        "and faults",
        target={"kind": "random", "border": 30.0},
        head_overrides=DYNAMIXEL_RESOLUTIONS,
        duration_s=3.0,
        band_px=2.0,
        variation=HARDWARE_LOOP,
    ),
    Scenario(
        name="webcam",
        description="two servos and two webcams on the desk: 30 frames a second through such "
        "a loop",
        head="turrets",
        head_overrides={"sensor": {"command_resolution_rad_s": TICK_RAD_S}},
        target={"kind": "random", "border": 30.0},
        duration_s=3.0,
        band_px=2.0,
        variation=WEBCAM_LOOP,
    ),
    Scenario(
        name="desk",
        description="as webcam, longer: servos swing, speeds late or none, stalls, losses, skew",
        head="turrets",
        head_overrides={"sensor": {"command_resolution_rad_s": TICK_RAD_S}},
        target={"kind": "random", "border": 30.0},
        duration_s=8.0,
        band_px=2.0,
        variation=DESK_LOOP,
    ),
    Scenario(
        name="step",
        description="the article's step: the target jumps by 100 mm at 1 m",
        target={"kind": "step", "before": (0.0, -0.1, 1.0), "after": (0.0, -0.2, 1.0)},
        duration_s=2.0,
        plants=_ALL_PLANTS,
    ),
    Scenario(
        name="workspace",
        description="from one point of the workspace to another, 0.3 to 2.5 m away",
        target={"kind": "random"},
        duration_s=2.0,
        plants=_ALL_PLANTS,
    ),
    Scenario(
        name="circle",
        description="the article's circle of 100 mm at 1 m, a turn in 63 s",
        target={"kind": "circle"},
        duration_s=10.0,
        target_moves=True,
        catch_up_s=1.0,
    ),
    Scenario(
        name="line",
        description="the article's line on its physical rig, at 10 mm/s",
        head="physical",
        target={"kind": "line"},
        duration_s=10.0,
        target_moves=True,
        catch_up_s=1.0,
    ),
    Scenario(
        name="fast",
        description="ellipses and sweeps of any place and plane, at up to 60 degrees/s",
        target={"kind": "orbit"},
        duration_s=4.0,
        target_moves=True,
        catch_up_s=1.0,
    ),
    Scenario(
        name="double-step",
        description="the workspace, where the target jumps on while the eyes still turn to it",
        target={"kind": "double-step"},
        duration_s=2.5,
    ),
    Scenario(
        name="occluded",
        description="as fast, and each trial's target is gone for 0.3 s on its way",
        target={"kind": "occluded"},
        duration_s=4.0,
        target_moves=True,
        catch_up_s=1.0,
    ),
    Scenario(
        name="wander",
        description="straight on at 5 to 40 degrees/s, and in another direction every 0.15 "
        "to 0.5 s",
        target={"kind": "wander"},
        duration_s=4.0,
        target_moves=True,
        catch_up_s=1.0,
    ),
    Scenario(
        name="robust",
        description="the workspace with unknown delay, lag, model errors, noise and dropped frames",
        # the true head's image of the target is up to 5 x 6 px away from the model's
        target={"kind": "random", "border": 30.0},
        duration_s=3.0,
        variation=Variation(
            latency_s=(0.03, 0.13),
            lag_s=(0.015, 0.06),
            detection_noise_px=(0.0, 0.15),
            dropped_frame_probability=(0.0, 0.1),
            model_errors=TWIN_ERRORS,
        ),
    ),
    Scenario(
        name="physical",
        description="the workspace with the physical head, each trial another one",
        head="physical",
        target={"kind": "random", "border": 30.0},
        duration_s=2.0,
        variation=Variation(model_errors=TWIN_ERRORS),
    ),
)


def _through(loop: str, *targets: str) -> list[Scenario]:
    """Make scenarios with the loop of one scenario and targets of others, e.g. `hardware-fast`."""
    by_name = {one.name: one for one in _SCENARIOS}
    made = by_name[loop]
    return [
        replace(
            made,
            name=f"{loop}-{name}",
            description=f"{by_name[name].description}; through the loop of {loop}",
            # the true head's image of a target that appears is away from the model's
            target=dict(by_name[name].target)
            | ({} if by_name[name].target_moves else {"border": made.target["border"]}),
            # the onset comes late
            duration_s=by_name[name].duration_s + LATEST_ONSET_S,
            target_moves=by_name[name].target_moves,
            catch_up_s=by_name[name].catch_up_s,
        )
        for name in targets
    ]


SCENARIOS: Final[dict[str, Scenario]] = {
    scenario.name: scenario
    for scenario in (
        *_SCENARIOS,
        *_through("hardware", "fast", "wander", "occluded", "double-step"),
        *_through("webcam", "fast", "wander"),
    )
}
"""The scenarios by name."""


def load_scenario(name: str) -> Scenario:
    """A scenario by name.

    Raises:
        UnknownNameError: there is no such scenario.
    """
    if name not in list(SCENARIOS):  # a list accepts unhashable names, too
        raise UnknownNameError("scenario", name, list(SCENARIOS))
    return SCENARIOS[name]

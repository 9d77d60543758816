"""Scenarios, controllers and a plant whose results are known beforehand."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vergence.envs.plant import Plant, TrialStart
from vergence.envs.plants.conditions import Variation
from vergence.envs.plants.kinematic import KinematicPlant
from vergence.envs.targets.motion import motion_rows
from vergence.envs.task import GazeTask
from vergence.eval.trials.scenarios import Scenario
from vergence.models.head_file import load_head

BEFORE, AFTER = (0.0, -0.1, 1.0), (0.02, -0.12, 1.0)
PERIOD_S = 1.0 / 120.0
NOISELESS = {"detection_noise_px": 0.0}


def ideal_head():
    """The simulated head without lag and with any acceleration: a command is a motion."""
    head = load_head("simulated")
    return head.replace(
        timing={"lag_s": 0.0},
        limits={"acceleration": np.full(7, 1e9)},
        sensor={"detection_noise_px": 0.0},
    )


@dataclass(frozen=True)
class ToyScenario:
    """Minimal scenario for `run_trials`, without a registry."""

    target: Any
    duration_s: float = 0.5
    band_px: float = 1.0
    target_moves: bool = False
    catch_up_s: float = 1.0
    name: str = "toy"
    head: Any = "simulated"

    def seed(self, split: str, seed: int = 0) -> int:
        return {"train": 0, "validation": 1000, "test": 2000}[split] + seed

    def task(self, num: int, plant: str = "kinematic", head: Any = None) -> GazeTask:
        return GazeTask(num, head=head or self.head, plant=plant, target=self.target)


STEP = ToyScenario({"kind": "step", "before": BEFORE, "after": AFTER}, head=ideal_head())


def late(low_s: float, high_s: float, **fields: object) -> Scenario:
    """The toys' step, at a moment of each trial's own."""
    options: dict = {"target": STEP.target, "duration_s": 1.0} | fields
    variation = Variation(onset_s=(low_s, high_s))
    return Scenario(name="late", description="a late step", variation=variation, **options)


class KnowsTheWay:
    """Turns the eyes onto the step's target in one period, `wait` periods after it began.

    Its state counts the periods; trials whose number is in `never` are left where they are.
    """

    def __init__(self, wait: int, never: tuple[int, ...] = ()) -> None:
        head = ideal_head()
        turn = (head.fixate(AFTER) - head.fixate(BEFORE))[3:]
        self.action = turn / PERIOD_S / head.limits.velocity[3:]
        assert np.abs(self.action).max() <= 1.0
        self.wait = wait
        self.never = never

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        steps = np.zeros(len(observation)) if state is None else state[0]
        steps = np.where(episode_start, 0, steps)
        go = steps == self.wait
        go &= ~np.isin(np.arange(len(go)), self.never)
        return np.where(go[:, None], self.action, 0.0), (steps + 1,)


class InTwoTurns:
    """Turns the eyes to some pixels beside the step's target and onto it, after so many periods."""

    def __init__(self, first: int, second: int, beside_px: float) -> None:
        head = ideal_head()
        off = head.project(head.fixate(BEFORE), AFTER) - head.cameras.principal
        self.share = beside_px / float(np.linalg.norm(off, axis=-1).max())
        self.action = KnowsTheWay(0).action
        self.turns = (first, second)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        steps = np.zeros(len(observation)) if state is None else state[0]
        steps = np.where(episode_start, 0, steps)
        part = (1.0 - self.share) * (steps == self.turns[0]) + self.share * (steps == self.turns[1])
        return part[:, None] * self.action, (steps + 1,)


class Shaking:
    """Another law, with a sinusoid on the second actuator's commands in the trials of some numbers.

    Its amplitude is a share of the actuator's speed.
    """

    def __init__(self, law: Any, share: float, hertz: float, whose: tuple[int, ...]) -> None:
        self.law, self.share, self.hertz, self.whose = law, share, hertz, whose
        self.step = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = self.law.predict(observation, state, episode_start, deterministic)
        if episode_start.all():
            self.step = 0
        action = np.array(action)
        wave = np.cos(2.0 * np.pi * self.hertz * self.step * PERIOD_S)
        action[np.isin(np.arange(len(action)), self.whose), 1] += self.share * wave
        self.step += 1
        return action, state


class BlindPlant(Plant):
    """A head like a real one: its world has the target of `STEP`, and nobody knows the truth."""

    def __init__(self, head, num=1):
        self.head, self.num = head, num
        self._hidden = KinematicPlant(head, num)

    def reset(self, ids, positions):
        """See `Plant.reset`; the eyes begin where they fixate the target before its jump."""
        rows = motion_rows(np.tile(AFTER, (len(ids), 1)), before=BEFORE)
        keys = np.zeros(len(ids), dtype=np.uint64)
        fixating = np.tile(self.head.fixate(BEFORE), (len(ids), 1))
        return self._hidden.begin(TrialStart(ids, keys, keys, fixating, rows))

    def step(self, command):
        return self._hidden.step(command)

    def close(self):
        self._hidden.close()

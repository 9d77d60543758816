"""The article's control law with gains that differ between trials run side by side."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.ibvs import ibvs_command
from vergence.envs.layout import ObservationLayout
from vergence.envs.plants.simulation import simulation_of
from vergence.envs.rollout import rollout
from vergence.envs.targets.target import Target
from vergence.envs.task import GazeTask
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray
from vergence.recording import Recorder


class PerTrialGainLaw:
    """The article's control law with gains per trial and a reference per control period.

    Args:
        head: the model that the law uses.
        gain: (..., 2, 2) by trial, eye and image axis, 1/s.
        reference: function from the control period, counted from 0, to the image position at which
            to hold the target: an array that broadcasts to (..., 2, 2), px from the principal
            points. None for the principal points.
    """

    def __init__(
        self,
        head: HeadModel,
        gain: FloatArray,
        reference: Callable[[int], FloatArray] | None = None,
    ) -> None:
        self._head, self._gain, self._reference = head, gain, reference
        self._layout = ObservationLayout.of(head)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], int]:
        """See `vergence.envs.rollout.Policy`; the state is the number of the control period."""
        step = 0 if state is None else int(state)
        seen = self._layout.decode(observation)
        error = seen.pixel_error
        if self._reference is not None:
            error = error - self._reference(step)
        limits = np.array(self._layout.action_limits)
        command = ibvs_command(
            seen.positions_at_exposure, error, self._gain, np.nan, limits, self._head.packed
        )
        return self._layout.action(command), step + 1


def servo_pixel_errors(
    head: HeadModel,
    target: Target | Mapping[str, Any],
    gains: ArrayLike,
    *,
    duration_s: float,
    seed: int,
    first_trial: int = 0,
    plant: str = "kinematic",
    plant_options: Mapping[str, Any] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Turn heads to a target under the article's control law, see `vergence.controllers.ibvs`.

    Args:
        head: the model that the law uses.
        target: the target of all trials.
        gains: (n, 2) the gains k1 and k2 of each trial, 1/s.
        duration_s: duration of the trials, s.
        seed: seed of all noise.
        first_trial: number of the first trial; the others take the next numbers.
        plant: the simulated plant.
        plant_options: the plant's own options, numbers or (n,) arrays.

    Returns:
        (steps,) seconds since time zero, and (steps, n, 2, 2) true pixel errors, px.
    """
    gain = np.asarray(gains, dtype=np.float64)
    # both eyes have the same gains
    law = PerTrialGainLaw(head, np.repeat(gain[:, None, :], 2, axis=1))
    task = GazeTask(len(gain), head=head, plant=plant, target=target, plant_options=plant_options)
    steps = round(duration_s * head.timing.control_rate_hz)
    simulation_of(task.plant)  # refuses a plant without ground truth
    record = Recorder(task, steps, reading=(), truth=("pixel_error",))
    rollout(task, law, steps, record, seed=seed, first_trial=first_trial)
    assert record.truth is not None
    time_s = np.arange(steps + 1) * head.timing.period_s
    return np.asarray(time_s), record.truth.pixel_error

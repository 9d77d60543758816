"""What trials really run with: by name for people, in rows for kernels."""

from typing import Any, Final, NamedTuple

import numpy as np

from vergence._jit import device
from vergence._runs import run_of
from vergence.envs.plants.imperfections import OWN
from vergence.models.parts import FloatArray

Place = int | np.unsignedinteger[Any]
"""A place in the batch; unsigned where no index has to be counted from the end."""


class Conditions(NamedTuple):
    """What the trials of a batch of heads really run with, hidden from the controller.

    The fields but the last are those of `vergence.envs.plants.imperfections`, see
    `vergence.envs.plants.variation.Variation`: (n,) each, (n, 7) by the neck's joints and the
    eyes' actuators.
    """

    latency_s: FloatArray
    lag_s: FloatArray
    detection_noise_px: FloatArray
    dropped_frame_probability: FloatArray
    jitter_s: FloatArray
    missed_detection_probability: FloatArray
    outlier_probability: FloatArray
    outlier_px: FloatArray
    frame_rate_hz: FloatArray
    frame_phase: FloatArray
    clock_drift: FloatArray
    command_latency_s: FloatArray
    feedback_latency_s: FloatArray
    angle_noise_rad: FloatArray
    speed_noise_rad_s: FloatArray
    acceleration_ratio: FloatArray
    torque_falloff: FloatArray
    onset_s: FloatArray
    speed_gain: FloatArray
    backlash_rad: FloatArray
    heads: FloatArray
    """(n or 1, PACKED) the true heads, see `vergence.models.kinematics`."""


class Drawn(NamedTuple):
    """The same as kernels take it, for whom few arrays are quick to hand on."""

    loop: FloatArray
    """(n, LOOP) a row of `Loop` for each trial."""
    own: FloatArray
    """(n, OWN, 7) speed gains, and backlashes in rad."""
    heads: FloatArray
    """(n or 1, PACKED)."""


class Loop(NamedTuple):
    """The conditions of one trial of which it has one number each."""

    latency_s: float
    lag_s: float
    detection_noise_px: float
    dropped_frame_probability: float
    jitter_s: float
    missed_detection_probability: float
    outlier_probability: float
    outlier_px: float
    frame_rate_hz: float
    frame_phase: float
    clock_drift: float
    command_latency_s: float
    feedback_latency_s: float
    angle_noise_rad: float
    speed_noise_rad_s: float
    acceleration_ratio: float
    torque_falloff: float
    onset_s: float
    frame_s: float
    """From one exposure to the next, by the rate and the clock's drift."""


LOOP: Final = len(Loop._fields)
_loop_run = run_of(LOOP)
GAIN: Final = OWN.index("speed_gain")
BACKLASH: Final = OWN.index("backlash_rad")


@device
def loop_of(drawn: Drawn, n: Place) -> Loop:
    """The conditions of one trial."""
    return Loop(*_loop_run(drawn.loop[n], 0))

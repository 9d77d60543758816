r"""Inputs of a network that has to identify the loop by itself: past data, and no prediction.

For each actuator: the turns requested by the last `STORED_IMAGES` images, the angles turned since
their exposures (as dated by the observation), and their ages; commands and velocities at the last
`STORED_MOMENTS` moments. Only these numbers carry information on delay, lag, acceleration and gain
of the loop. Images come from the outlier gate, and each enters once: an observation repeats its
newest image until the next one arrives.

A moment is one control period, or the mean of several if the control rate is so high that
`STORED_MOMENTS` periods are shorter than an image's nominal latency plus
`MIN_REACH_BEYOND_LATENCY_S`. The first moment is the present one, which may have begun a single
period ago.
"""

from math import ceil
from typing import Annotated, Final

import numpy as np

from vergence.controllers.networks.resolutions import (
    COARSE_RAD,
    FINE_RAD,
    LOG_RAD,
    LOG_SPEED,
    MIDDLE_RAD,
    clip_to_unit,
    symlog_scaled,
)
from vergence.controllers.outlier_gate import GatedDetections
from vergence.controllers.rows import make_row, record_view, row_layout, row_size
from vergence.envs.observation import AGE_S, Observation, ObservationLayout
from vergence.kernels import inlined, kernel
from vergence.models.head import HeadModel
from vergence.models.kinematics import (
    PACKED,
    PackedHead,
    eye_actuator_angle,
    eye_actuator_velocity,
    has_motor_per_joint,
)
from vergence.models.parts import FloatArray

STORED_IMAGES: Final = 4
"""Number of images stored (chosen: information against size of the inputs)."""
STORED_MOMENTS: Final = 16
"""Number of moments for which commands and velocities are stored (chosen: likewise)."""
MIN_REACH_BEYOND_LATENCY_S: Final = 0.05
"""Least time that the moments reach beyond the nominal latency of an image, s (chosen)."""

_OF_IMAGE: Final = (
    *("asked", "asked_log", "asked_middle", "asked_fine"),
    *("turned_log", "turned_middle", "age", "seen"),
)
HISTORY_CHANNELS: Final = (
    *("fresh", "velocity", "velocity_log"),
    *(f"{name}_{k}" for k in range(STORED_IMAGES) for name in _OF_IMAGE),
    *(f"{name}_{k}" for k in range(STORED_MOMENTS) for name in ("command", "speed")),
)
"""Channels of `history`; index 0 is the newest.

| channel | meaning |
| --- | --- |
| `fresh` | 1 if an image of an eye that the actuator moves has just arrived, otherwise 0 |
| `velocity` | measured velocity / largest command; `_log` with x0 = 0.005 |
| `asked_k` | turn requested by image k / 1.5 rad; `_log` with x0 = 1 mrad |
| `asked_middle_k`, `asked_fine_k` | that turn / 0.1 and 0.01 rad, saturated |
| `turned_log_k`, `turned_middle_k` | angle turned since its exposure, scaled likewise |
| `age_k` | age of the image / 0.5 s, saturated |
| `seen_k` | 1 if the image shows the target, otherwise 0 |
| `command_k` | command at moment k / largest command |
| `speed_k` | measured velocity at moment k / largest command |
"""


class InputHistoryState:
    """State for one head, (4,) by actuator."""

    requested_turns: Annotated[FloatArray, STORED_IMAGES, 4]
    """Turns requested by the last images, rad."""
    shows_target: Annotated[FloatArray, STORED_IMAGES, 4]
    """1 if the image shows the target, otherwise 0."""
    angles_at_exposure: Annotated[FloatArray, STORED_IMAGES, 4]
    """Actuator angles at their exposures, rad."""
    age_s: Annotated[FloatArray, STORED_IMAGES, 4]
    """Ages of the images, s."""
    commands: Annotated[FloatArray, STORED_MOMENTS, 4]
    """Commands at the last moments, rad/s; for the first moment their sum so far."""
    speeds: Annotated[FloatArray, STORED_MOMENTS, 4]
    """Measured velocities, rad/s, likewise."""
    periods_in_moment: float
    """Number of periods in the first moment so far."""


class _Law:
    """Constants of the history."""

    period_s: float
    every: float
    """Number of periods in a moment."""
    limits: Annotated[FloatArray, 4]
    """Largest commands, rad/s."""
    moved: Annotated[FloatArray, 2, 4]
    """1 if an actuator moves an eye, otherwise 0."""


_STATE: Final = row_layout(InputHistoryState)
_SIZE: Final = row_size(_STATE)
_LAW: Final = row_layout(_Law)
_COUNT: Final = len(HISTORY_CHANNELS)


class InputHistory:
    """Past images, commands and velocities of a head, as inputs of a network.

    The state is one packed row.

    Args:
        head: the model of the head.
        layout: the layout of observations.
        moved: (2, 4) 1 if an actuator moves an eye, otherwise 0.
    """

    size: Final = _SIZE
    """S, length of the state."""

    def __init__(self, head: HeadModel, layout: ObservationLayout, moved: FloatArray) -> None:
        self._head = head
        kept_s = layout.latency_s + MIN_REACH_BEYOND_LATENCY_S
        self._law = make_row(
            _LAW,
            period_s=layout.period_s,
            every=max(1, ceil(kept_s / (STORED_MOMENTS * layout.period_s) - 1e-9)),
            limits=layout.action_limits,
            moved=moved,
        )

    @property
    def moment_s(self) -> float:
        """Duration of a moment, s."""
        law: _Law = self._law.view(_LAW)[0]
        return law.every * law.period_s

    def initial(self) -> FloatArray:
        """(S,) the state at a trial's start."""
        return make_row(_STATE, age_s=AGE_S)

    def update(
        self,
        seen: Observation,
        detections: GatedDetections,
        requested_turn: FloatArray,
        state: FloatArray,
        shape_only: FloatArray,
    ) -> FloatArray:
        """Update with one control period's observation.

        Args:
            seen: the observation.
            detections: detections that passed the outlier gate.
            requested_turn: (..., 4) turns requested by the images of `detections`, rad.
            state: (..., S) updated in place.
            shape_only: (channels, 4) array of any values; only its shape counts, which is that of
                the result.

        Returns:
            (..., channels, 4) the channels, in the order of `HISTORY_CHANNELS`.
        """
        state[...], out = update_history_and_channels(
            state,
            requested_turn,
            detections.pixel_error,
            detections.positions_at_exposure,
            detections.fresh,
            seen.image_age_s,
            seen.positions,
            seen.velocities,
            seen.last_command,
            self._law,
            self._head.packed,
            shape_only,
        )
        return np.asarray(out)


@inlined
def _enter(
    s: InputHistoryState, j: int, asked: float, seen: float, exposed: float, age_s: float
) -> None:
    """Store a new image of an actuator first, and shift the older ones."""
    for k in range(STORED_IMAGES - 1, 0, -1):
        s.requested_turns[k, j], s.shows_target[k, j] = (
            s.requested_turns[k - 1, j],
            s.shows_target[k - 1, j],
        )
        s.angles_at_exposure[k, j], s.age_s[k, j] = (
            s.angles_at_exposure[k - 1, j],
            s.age_s[k - 1, j],
        )
    s.requested_turns[0, j], s.shows_target[0, j] = asked, seen
    s.angles_at_exposure[0, j], s.age_s[0, j] = exposed, age_s


@inlined
def _begin_moment(s: InputHistoryState) -> None:
    """Replace the sums of the first moment by means, and begin another one."""
    for j in range(4):
        s.commands[0, j] /= s.periods_in_moment
        s.speeds[0, j] /= s.periods_in_moment
        for k in range(STORED_MOMENTS - 1, 0, -1):
            s.commands[k, j], s.speeds[k, j] = s.commands[k - 1, j], s.speeds[k - 1, j]
        s.commands[0, j] = s.speeds[0, j] = 0.0
    s.periods_in_moment = 0.0


@kernel(
    ["(f8[:],f8[:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],f8[:],f8[:,:])"],
    f"({_SIZE}),(4),(2,2),(7),(2),(),(7),(7),(4),({row_size(_LAW)}),({PACKED}),({_COUNT},4)->({_SIZE}),({_COUNT},4)",
)
def update_history_and_channels(
    state_before: FloatArray, requested_turn: FloatArray, error: FloatArray,
    angles_at_exposure: FloatArray, fresh: FloatArray, age_s: FloatArray, q: FloatArray,
    velocities: FloatArray, command: FloatArray, law_row: FloatArray, p: PackedHead,
    shape_only: FloatArray, state_after: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Update the state with one observation, and compute the channels from it."""
    for i in range(_SIZE):
        state_after[i] = state_before[i]
    s: InputHistoryState = record_view(state_after, _STATE)
    law: _Law = record_view(law_row, _LAW)
    direct = has_motor_per_joint(p)
    if s.periods_in_moment > law.every - 0.5:
        _begin_moment(s)
    s.periods_in_moment += 1.0
    for j in range(4):
        for k in range(STORED_IMAGES):
            s.age_s[k, j] = min(s.age_s[k, j] + law.period_s, AGE_S)
        limit = law.limits[j]
        if not limit > 0.0:  # no such actuator
            for c in range(out.shape[0]):
                out[c, j] = 0.0
            continue
        angle, exposed, speed = q[3 + j], angles_at_exposure[3 + j], velocities[3 + j]
        if not direct:
            angle, exposed = (
                eye_actuator_angle(p, j, q[3:]),
                eye_actuator_angle(p, j, angles_at_exposure[3:]),
            )
            speed = eye_actuator_velocity(p, j, velocities[3:])
        new = seen = 0.0
        for eye in range(2):
            if law.moved[eye, j] > 0.5:
                new = max(new, fresh[eye])
                # false for nan
                seen = max(seen, 1.0 if error[eye, 0] == error[eye, 0] else 0.0)
        if new > 0.5:
            _enter(s, j, requested_turn[j], seen, exposed, min(age_s[0], AGE_S))
        s.commands[0, j] += command[j]
        s.speeds[0, j] += speed
        out[0, j] = new
        out[1, j] = clip_to_unit(speed / limit)
        out[2, j] = symlog_scaled(speed / limit, LOG_SPEED, 1.0)
        c = 3
        for k in range(STORED_IMAGES):
            turn, turned = s.requested_turns[k, j], 0.0
            if s.shows_target[k, j] > 0.5:
                turned = angle - s.angles_at_exposure[k, j]
            out[c, j] = clip_to_unit(turn / COARSE_RAD)
            out[c + 1, j] = symlog_scaled(turn, LOG_RAD, COARSE_RAD)
            out[c + 2, j] = clip_to_unit(turn / MIDDLE_RAD)
            out[c + 3, j] = clip_to_unit(turn / FINE_RAD)
            out[c + 4, j] = symlog_scaled(turned, LOG_RAD, COARSE_RAD)
            out[c + 5, j] = clip_to_unit(turned / MIDDLE_RAD)
            out[c + 6, j] = s.age_s[k, j] / AGE_S
            out[c + 7, j] = s.shows_target[k, j]
            c += 8
        for k in range(STORED_MOMENTS):
            lasted = s.periods_in_moment if k == 0 else 1.0
            out[c, j] = clip_to_unit(s.commands[k, j] / (lasted * limit))
            out[c + 1, j] = clip_to_unit(s.speeds[k, j] / (lasted * limit))
            c += 2

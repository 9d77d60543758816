"""Laws on pixel errors in a loop with outliers, missed detections and quantised commands.

A gate on detections holds outliers back and bridges missed detections. Per eye, a detection p that
arrives a time t after the last accepted one, p_0, is accepted if

    |p - p_0| <= tolerance + 2 v t

with v the largest recent speed of the image: the eye's measured joint speed times the focal length,
or the rate between accepted detections; both decay over the latency of images. Any other detection
is held back, as if its frame had been dropped, until a later one confirms it. A later one close to
it confirms a jump of the target; one on the line from p_0 through it confirms that the target has
started to move. After several inconsistent detections in a row one is accepted, so that nothing is
held for ever.

A missed detection counts as a dropped frame too: a single one always, several for `MAX_BRIDGED_S`.
After that, or at once if the image moves so fast that motion blur may hide the target, the eye
counts as not seeing its target: it has to come to rest to see it again.

Commands are quantised for actuators that do not move at one step or less: a slow turn is made of
pulses of two steps, with pauses. The rounding error is carried over to the next period, so that the
mean velocity is the requested one (first-order sigma-delta modulation). Otherwise a law
proportional to the error would stop short: with a gain of 3 per second and a step of 0.024 rad/s,
at 12 mrad, which are seven pixels at a focal length of 620 pixels.

In a loop without these faults neither changes anything.
"""

from abc import abstractmethod
from math import exp, hypot, inf, isfinite, nan
from typing import Annotated, Final, NamedTuple

import numpy as np

from vergence.controllers.controller import StatefulController
from vergence.envs.observation import AGE_S, Observation, ObservationLayout
from vergence.kernels import inlined, kernel, make_row, record_view, row_layout, row_size
from vergence.models.head import HeadModel
from vergence.models.parts import SLOTS, FloatArray

_PERIOD_TOLERANCE: Final = 0.3
"""Fraction of a period up to which exposure times are equal (chosen: float32 and jitter)."""


@inlined
def is_fresh(age_s: float, last_age_s: float, period_s: float) -> bool:
    """True if the newest image, given its present and last age, came within the last period.

    An old image ages by one period per period; one exposed later is new, whatever its age. If a
    late step skips a period, an image exposed less than 1.3 periods later may be taken for the old
    one. From `AGE_S` on the observation gives no age, and nothing is fresh.
    """
    later = period_s - (age_s - last_age_s)
    return age_s < AGE_S and later > _PERIOD_TOLERANCE * period_s


TOLERANCE_PX: Final = 6.0
"""Largest distance between detections at rest, px, besides six sigma of noise (chosen)."""
MAX_BRIDGED_S: Final = 0.05
"""Time for which several missed detections count as dropped frames, s (chosen)."""
MAX_HELD_DETECTIONS: Final = 3
"""Most detections in a row that are held back (chosen: outliers against reaction time)."""
_SPEED_MARGIN: Final = 2.0
"""Largest image speed to the known one (chosen: nominal exposure times, acceleration)."""
_SPEED_DECAY_S: Final = 0.1
"""Time constant of the speed's decay, in addition to the images' latency, s (chosen)."""
_MAX_SWERVE_RATIO: Final = 0.5
"""Deviation of a starting target from its straight line, as a fraction of its step (chosen)."""
_SHARP_BLUR_FRACTION: Final = 0.5
"""Fraction of the largest motion blur below which a target is certainly detected (chosen)."""
_HELD, _ACCEPTED, _JUMPED = 0, 1, 2
"""Verdicts; the last one accepts a jump of the target (numerical)."""


class GatedDetections(NamedTuple):
    """Detections that a law acts on."""

    pixel_error: FloatArray
    """(..., 2, 2) undistorted pixel minus principal point, px; nan where not visible."""
    positions_at_exposure: FloatArray
    """(..., 7) joint angles at their exposure, rad."""
    fresh: FloatArray
    """(..., 2) 1 for an eye with a new detection, or that has just lost its target; otherwise 0."""
    jumped: FloatArray
    """(..., 2) 1 for an eye whose fresh detection shows a jump of its target; otherwise 0."""


class EyeGateState:
    """State of the gate for one eye: its last accepted detection, and the last one held back.

    Counts are of detections in a row; the speed is the image's largest recent one.
    """

    accepted_error_px: Annotated[FloatArray, 2]
    accepted_angles_rad: Annotated[FloatArray, 2]
    accepted_since_s: float
    held_error_px: Annotated[FloatArray, 2]
    held_since_s: float
    held_count: float
    missed_count: float
    speed_px_s: float
    sees_target: float


class GateState:
    """State of the gate for one head."""

    eyes: Annotated[list[EyeGateState], 2]
    image_age_s: float


class GateLaw:
    """Constants of the outlier gate."""

    tolerance_px: float
    focal_px: Annotated[FloatArray, 2]
    smearing_px_s: float
    """Image speed above which motion blur may hide the target, px/s."""
    speed_decay: float
    """Per-period decay factor of a speed."""
    period_s: float


GATE_STATE: Final = row_layout(GateState)
_SIZE: Final = row_size(GATE_STATE)
GATE_LAW: Final = row_layout(GateLaw)


class OutlierGate:
    """The gate of a head, with its state in one packed row."""

    size: Final = _SIZE
    """S, length of the state."""

    def __init__(self, head: HeadModel, layout: ObservationLayout) -> None:
        exposure_s = head.timing.exposure_s
        sharp_px = _SHARP_BLUR_FRACTION * head.sensor.max_smear_px
        self._law = make_row(
            GATE_LAW,
            tolerance_px=TOLERANCE_PX + 6.0 * head.sensor.detection_noise_px,
            focal_px=head.cameras.focal.max(axis=-1),
            smearing_px_s=sharp_px / exposure_s if exposure_s else inf,
            speed_decay=exp(-layout.period_s / (_SPEED_DECAY_S + layout.latency_s)),
            period_s=layout.period_s,
        )

    def initial(self) -> FloatArray:
        """(S,) the state at a trial's start."""
        return make_row(GATE_STATE, image_age_s=AGE_S)

    def update(self, seen: Observation, state: FloatArray) -> GatedDetections:
        """Update the (..., S) state in place and return the detections to act on."""
        state[...], *detections = update_gate(
            state, seen.pixel_error, seen.image_age_s, seen.positions_at_exposure, seen.velocities,
            self._law,
        )  # fmt: skip
        return GatedDetections(*detections)


@inlined
def _classify(g: EyeGateState, law: GateLaw, u: float, v: float) -> int:
    """Classify a detection as held back, accepted or a jump; consistent motion raises the speed."""
    if g.sees_target < 0.5:
        return _ACCEPTED
    u_0, v_0 = g.accepted_error_px[0], g.accepted_error_px[1]
    off = hypot(u - u_0, v - v_0)
    if off <= law.tolerance_px + _SPEED_MARGIN * g.speed_px_s * g.accepted_since_s:
        if off > 0.5 * law.tolerance_px:
            g.speed_px_s = max(g.speed_px_s, off / g.accepted_since_s)
        return _ACCEPTED
    if g.held_count < 0.5:
        return _HELD
    if g.held_count > MAX_HELD_DETECTIONS - 0.5:
        return _JUMPED
    room = law.tolerance_px + _SPEED_MARGIN * g.speed_px_s * g.held_since_s
    u_1, v_1 = g.held_error_px[0], g.held_error_px[1]
    beside = hypot(u - u_1, v - v_1)
    if beside <= room:
        return _JUMPED
    du, dv = u_1 - u_0, v_1 - v_0
    on = g.held_since_s / (g.accepted_since_s - g.held_since_s)
    swerve = hypot(u - u_1 - on * du, v - v_1 - on * dv)
    if swerve <= room + _MAX_SWERVE_RATIO * hypot(du, dv):
        g.speed_px_s = max(g.speed_px_s, beside / g.held_since_s)
        return _ACCEPTED
    return _HELD


@kernel(
    ["(f8[:],f8[:,:],f8[:],f8[:],f8[:],f8[:],f8[:],f8[:,:],f8[:],f8[:],f8[:])"],
    f"({_SIZE}),(2,2),(),(7),(7),({row_size(GATE_LAW)})->({_SIZE}),(2,2),(7),(2),(2)",
)
def update_gate(
    state_before: FloatArray, error: FloatArray, age_s: FloatArray, q: FloatArray,
    velocities: FloatArray, law_row: FloatArray, state_after: FloatArray, accepted: FloatArray,
    angles_at_exposure: FloatArray, fresh: FloatArray, jumped: FloatArray,
) -> None:  # fmt: skip
    """Compute the updated state and the fields of `GatedDetections`."""
    for k in range(_SIZE):
        state_after[k] = state_before[k]
    s: GateState = record_view(state_after, GATE_STATE)
    law: GateLaw = record_view(law_row, GATE_LAW)
    new = is_fresh(age_s[0], s.image_age_s, law.period_s)
    s.image_age_s = age_s[0]
    for j in range(7):
        angles_at_exposure[j] = q[j]
    for eye in range(2):
        g = s.eyes[eye]
        first = 3 + 2 * eye
        turning = law.focal_px[eye] * hypot(velocities[first], velocities[first + 1])
        g.speed_px_s = max(law.speed_decay * g.speed_px_s, turning)
        g.accepted_since_s += law.period_s
        g.held_since_s += law.period_s
        u, v = error[eye, 0], error[eye, 1]
        fresh[eye] = jumped[eye] = 0.0
        if not new:
            pass
        elif isfinite(u) and isfinite(v):
            g.missed_count = 0.0
            verdict = _classify(g, law, u, v)
            if verdict != _HELD:
                g.accepted_error_px[0], g.accepted_error_px[1] = u, v
                g.accepted_angles_rad[0], g.accepted_angles_rad[1] = q[first], q[first + 1]
                g.accepted_since_s = g.held_count = 0.0
                g.sees_target = fresh[eye] = 1.0
                jumped[eye] = 1.0 if verdict == _JUMPED else 0.0
            else:
                g.held_error_px[0], g.held_error_px[1] = u, v
                g.held_since_s = 0.0
                g.held_count += 1.0
        else:
            g.missed_count += 1.0
            late = g.missed_count > 1.5 and g.accepted_since_s > MAX_BRIDGED_S
            if g.sees_target < 0.5 or late or g.speed_px_s > law.smearing_px_s:
                g.sees_target = g.held_count = 0.0
                fresh[eye] = 1.0
        accepted[eye, 0] = accepted[eye, 1] = nan
        if g.sees_target > 0.5:
            accepted[eye, 0], accepted[eye, 1] = g.accepted_error_px[0], g.accepted_error_px[1]
            angles_at_exposure[first] = g.accepted_angles_rad[0]
            angles_at_exposure[first + 1] = g.accepted_angles_rad[1]


_ROUNDING: Final = 1e-9
"""Relative tolerance for rounding the limit to whole steps (numerical)."""


class CommandQuantiser:
    """Quantises a head's commands within (4,) limits, rad/s, and carries rounding errors over."""

    def __init__(self, head: HeadModel, limits: FloatArray) -> None:
        self.step_rad_s = head.sensor.command_resolution_rad_s
        self._limits = np.array(limits)

    def quantise(self, command: FloatArray, carried: FloatArray) -> FloatArray:
        """Compute the commands to send, rad/s, and update the errors carried over in place.

        Without a resolution the commands stay as they are. A zero requests rest, and discards the
        error carried over.
        """
        if not self.step_rad_s > 0.0:
            return command
        carried[...], quantised = quantise_command(carried, command, self.step_rad_s, self._limits)
        return np.asarray(quantised)


@kernel(["(f8[:],f8[:],f8[:],f8[:],f8[:],f8[:])"], "(4),(4),(),(4)->(4),(4)")
def quantise_command(
    carried_before: FloatArray, command: FloatArray, step: FloatArray, limits: FloatArray,
    carried_after: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Quantise commands to whole steps, never a single one, and carry up to 1.5 steps over."""
    size = step[0]
    for k in range(4):
        carried_after[k] = out[k] = 0.0
        if command[k] == 0.0:
            continue
        wanted = command[k] + carried_before[k]
        most = np.floor(limits[k] / size * (1.0 + _ROUNDING))
        count = min(max(np.rint(wanted / size), -most), most)
        if abs(count) < 1.5:
            count = 0.0
        out[k] = size * count
        # an excess over 1.5 steps was cut off by the limits and is discarded
        carried_after[k] = min(max(wanted - out[k], -1.5 * size), 1.5 * size)


class GatedImageController(StatefulController):
    """Base of laws on pixel errors between an `OutlierGate` and a `CommandQuantiser`.

    The state is that of the gate, then the law's own, then the rounding errors of the commands.
    """

    def __init__(self, *, head: HeadModel, layout: ObservationLayout) -> None:
        super().__init__(head=head, layout=layout)
        self._gate = OutlierGate(head, self.layout)
        self._quantiser = CommandQuantiser(head, self.layout.action_limits)

    def _own_initial(self) -> FloatArray:
        """(S,) the law's own state at a trial's start; empty unless overridden."""
        return np.zeros(0)

    @abstractmethod
    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        """(..., 4) velocities of the eyes' actuators, rad/s; changes `own` (..., S) in place."""

    def _initial(self) -> FloatArray:
        return np.concatenate([self._gate.initial(), self._own_initial(), np.zeros(SLOTS)])

    def _command(self, seen: Observation, state: FloatArray) -> FloatArray:
        gate, own = state[..., : OutlierGate.size], state[..., OutlierGate.size : -SLOTS]
        command = self._law(self._gate.update(seen, gate), own)
        return self._quantiser.quantise(command, state[..., -SLOTS:])

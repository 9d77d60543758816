"""Image-based visual servoing with a fixed gain: the article's law, the reference policy.

Per eye, with p the undistorted pixel of the target, p* the principal point and J the 2x2 image
Jacobian with respect to the eye's two joints, tilt and pan in the article (Eqs. 12 and 13),

    theta_dot = J^-1 K (p* - p),   K = diag(k1, k2)

so that the pixel error decays as exp(-k t) if the loop has no delay. J belongs to the image: it is
computed at the joint angles of the exposure, with the complete interaction matrix, since tilt moves
the optical centre too. Its depth comes from triangulating the two pixels, or is a constant.

If actuators couple the eyes' joints, or an eye lacks a joint, the image velocities that the law
requests are distributed to the actuators by least squares in pixels (`vergence.models.fixation`).
Part of a pixel error may be out of reach: for eyes with a common tilt, only the common part of the
two vertical errors can be removed. A law that acted on the rest would wind up, or, if its gains
differ between axes, settle beside the least error. So laws act on the reducible part of the error
(`vergence.envs.reward`),

    e_r = J A s,   s = argmin |J A s - e|^2

with J the image Jacobian of both eyes and A the joint angles per actuator angle. At the least error
e_r is zero, whatever remains of e.
"""

from math import isfinite, nan
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.controllers.controller import checked_layout
from vergence.controllers.gate import GatedDetections, GatedImageController
from vergence.controllers.tuned import find_tuned_or_fallback, is_tuned_for, shipped_table
from vergence.envs.observation import ObservationLayout
from vergence.envs.reading import check_finite_number, real_number_array
from vergence.envs.reward import image_jacobians, reducible_error_by_jacobian
from vergence.errors import ConfigurationError, UnknownNameError
from vergence.kernels import inlined, kernel, subroutine
from vergence.models.fixation import actuator_least_squares
from vergence.models.head import HeadModel
from vergence.models.kinematics import PACKED, PackedHead, camera_of, eye_frames, eye_jacobian
from vergence.models.parts import FloatArray, LoopTiming
from vergence.triangulation.rays import depths_on_rays, rays_from_pixel_errors

Depth = Literal["triangulated"] | float
"""Option of the laws: the target's depth, `triangulated` or a constant, m."""


def reducible_pixel_error(
    head: HeadModel, q: ArrayLike, pixel_error: FloatArray, depth: ArrayLike
) -> FloatArray:
    """Compute the (..., 2, 2) part of pixel errors that the actuators can remove, px.

    It is nan where an eye does not see the target. With a motor per joint it is the error itself.
    """
    if head.actuation.direct:
        return pixel_error
    return np.asarray(reducible_errors(q, pixel_error, depth, head.packed))


@subroutine
def limited_actuator_velocities(
    p: PackedHead, q: FloatArray, error: FloatArray, depth_m: float, limit: FloatArray,
    velocities_in_out: FloatArray,
) -> float:  # fmt: skip
    """Replace image velocities (left u, v, right u, v), px/s, by the nearest ones of actuators.

    Returns the factor by which they, in rad/s, exceeded the limits, to which they are scaled down.
    """
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = _sees(error, 0), _sees(error, 1)
    image_jacobians(p, q, error, depth_m, left, right, jacobian)
    for k in range(4):
        wanted[k // 2, k % 2] = velocities_in_out[k]
    actuator_least_squares(p, jacobian, wanted, left, right, velocities_in_out)
    return _limited(limit, velocities_in_out)


@inlined
def _limited(limit: FloatArray, out: FloatArray) -> float:
    """Scale velocities down to the limits; return the factor by which they exceeded them."""
    excess = 1.0
    for k in range(4):
        if out[k] != 0.0 and limit[k] > 0.0:
            excess = max(excess, abs(out[k]) / limit[k])
    for k in range(4):
        out[k] = out[k] / excess if isfinite(out[k]) and limit[k] > 0.0 else 0.0
    return excess


@inlined
def _sees(error: FloatArray, eye: int) -> bool:
    return isfinite(error[eye, 0]) and isfinite(error[eye, 1])


@kernel(["(f8[:],f8[:,:],f8[:],f8[:],f8[:,:])"], f"(7),(2,2),(),({PACKED})->(2,2)")
def reducible_errors(
    q: FloatArray, pixel_error: FloatArray, depth_m: FloatArray, p: PackedHead, out: FloatArray
) -> None:
    """Compute the reducible part of pixel errors; a `depth_m` of nan is triangulated."""
    jacobian = np.zeros((2, 2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, depth_m[0], left, right, jacobian)
    reducible_error_by_jacobian(p, jacobian, pixel_error, left, right, out)


_LAW_TYPES: Final = ("(f8[:],f8[:,:],f8[:,:],f8[:],f8[:],f8[:],f8[:])",)
_LAW_SHAPES: Final = f"(7),(2,2),(2,2),(),(4),({PACKED})->(4)"


@kernel(_LAW_TYPES, _LAW_SHAPES)
def coupled_command(
    q: FloatArray, pixel_error: FloatArray, gain: FloatArray, depth_m: FloatArray,
    limit: FloatArray, p: PackedHead, out: FloatArray,
) -> None:  # fmt: skip
    """Compute actuator velocities from pixel errors for heads with coupled joints."""
    jacobian, wanted = np.zeros((2, 2, 2)), np.zeros((2, 2))
    left, right = _sees(pixel_error, 0), _sees(pixel_error, 1)
    image_jacobians(p, q, pixel_error, depth_m[0], left, right, jacobian)
    reducible_error_by_jacobian(p, jacobian, pixel_error, left, right, wanted)
    for eye in range(2):
        for axis in range(2):
            wanted[eye, axis] *= -gain[eye, axis]
    actuator_least_squares(p, jacobian, wanted, left, right, out)
    _limited(limit, out)


_ARTICLE_GAIN: Final = 4.0
"""The article's gain, 1/s."""
_GAIN_DELAY: Final = 0.42
"""Gain times the loop's delay that overshoots by some 1 % (measured: heads of 105 to 155 ms;
an integrator behind a dead time is critically damped at 1/e)."""


def gain_for_loop(timing: LoopTiming) -> float:
    """The article's gain, or less in a slower loop than its 105 ms, which would overshoot, 1/s."""
    delay_s = timing.latency_s + timing.command_latency_s + timing.feedback_latency_s + timing.lag_s
    delay_s += 0.5 * (timing.frame_s + timing.period_s)
    return min(_ARTICLE_GAIN, round(_GAIN_DELAY / delay_s, 2))


class IBVS:
    """The article's law.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        gain: k in 1/s: a number, (k1, k2) for u and v, or (2, 2) by eye and image axis.
        depth: `triangulated`, or a constant depth in metres.
        speed_limit: largest commanded speed of an actuator, rad/s, below the head's own limit; a
            command beyond it is scaled down, keeping its direction. None for the head's limit.

    Raises:
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout, gain: ArrayLike = _ARTICLE_GAIN,
        depth: Depth = "triangulated", speed_limit: float | None = None,
    ) -> None:  # fmt: skip
        self.head = head
        self.layout = checked_layout(head, layout)
        self.gain = as_gains("gain", gain)
        self._depth = depth_or_nan(depth)
        self._limit = speed_limits(layout, speed_limit)

    def predict(
        self, observation: NDArray[Any], state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None, deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:  # fmt: skip
        """Choose actions, see `Controller.predict`; the law has no state."""
        seen = self.layout.decode(observation)
        command = self.command(seen.positions_at_exposure, seen.pixel_error)
        return self.layout.action(command), state

    def command(self, q: ArrayLike, pixel_error: ArrayLike) -> FloatArray:
        """Compute the law's velocities in physical units.

        Args:
            q: (..., 7) joint angles at the exposure, rad.
            pixel_error: (..., 2, 2) undistorted pixel minus principal point, px; nan for an eye
                that does not see the target and is held still.

        Returns:
            (..., 4) velocities of the eyes' actuators, rad/s.
        """
        return ibvs_velocities(self.head, q, pixel_error, self.gain, self._depth, self._limit)


def ibvs_velocities(
    head: HeadModel, q: ArrayLike, pixel_error: ArrayLike, gain: ArrayLike, depth: ArrayLike,
    limit: ArrayLike,
) -> FloatArray:  # fmt: skip
    """Compute the law's (..., 4) actuator velocities, rad/s, with (..., 2, 2) gains, 1/s."""
    law: Any = ibvs_command if head.actuation.direct else coupled_command
    return np.asarray(law(q, pixel_error, gain, depth, limit, head.packed))


def as_gains(name: str, gain: ArrayLike) -> FloatArray:
    """Check gains: a number, (k1, k2) for u and v, or (2, 2) by eye and image axis, as returned."""
    try:
        gains = np.broadcast_to(real_number_array(gain), (2, 2)).copy()
    except (TypeError, ValueError) as error:
        raise ConfigurationError(
            f"{name}: expected a number, (k1, k2) or a (2, 2) array, got {gain!r}"
        ) from error
    if not (np.isfinite(gains) & (gains >= 0.0)).all():
        raise ConfigurationError(f"{name}: expected finite gains >= 0, got {gain!r}")
    return gains


def depth_or_nan(depth: str | float) -> float:
    """Check a law's depth, `triangulated` or metres, and return metres or nan."""
    if isinstance(depth, str):
        if depth != "triangulated":
            raise ConfigurationError(f"depth: expected 'triangulated' or metres, got {depth!r}")
        return nan
    if check_finite_number("depth", depth) <= 0.0:
        raise ConfigurationError(f"depth: expected metres above 0, got {depth!r}")
    return float(depth)


def speed_limits(layout: ObservationLayout, speed_limit: float | None) -> FloatArray:
    """Return the (4,) largest speeds of a layout's actuators under a law's own limit, rad/s."""
    limit = np.array(layout.action_limits)
    if speed_limit is None:
        return limit
    if check_finite_number("speed_limit", speed_limit) <= 0.0:
        raise ConfigurationError(f"speed_limit: expected rad/s above 0, got {speed_limit!r}")
    return np.minimum(limit, speed_limit)


@inlined
def limited_joint_velocities(
    p: PackedHead, q: FloatArray, error: FloatArray, depth_m: float, limit: FloatArray,
    velocities_in_out: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Do what `limited_actuator_velocities` does, by eye, for a head with a motor per joint."""
    left, right = eye_frames(p, 0, q[3], q[4]), eye_frames(p, 1, q[5], q[6])
    depth_l = depth_r = depth_m
    if not isfinite(depth_m):
        ray_l, ray_r = rays_from_pixel_errors(p, left.camera, right.camera, error)
        depth_l, depth_r, _found = depths_on_rays(ray_l, ray_r)
    excess_l = excess_r = 1.0
    for eye in range(2):
        du, dv = error[eye, 0], error[eye, 1]
        ru, rv = velocities_in_out[2 * eye], velocities_in_out[2 * eye + 1]
        velocities_in_out[2 * eye] = velocities_in_out[2 * eye + 1] = 0.0
        if not (isfinite(du) and isfinite(dv)):
            continue
        camera = camera_of(p, eye)
        u, v = camera.centre_u + du, camera.centre_v + dv
        frames, depth = (left, depth_l) if eye == 0 else (right, depth_r)
        u1, u2, v1, v2 = eye_jacobian(p, eye, frames, u, v, depth)
        det = u1 * v2 - u2 * v1
        # a singular pose (the image moves along one direction only) has no solution: hold
        if not abs(det) > 1e-6 * camera.focal_u * camera.focal_v:
            continue
        first, second = (v2 * ru - u2 * rv) / det, (u1 * rv - v1 * ru) / det
        excess = max(1.0, abs(first) / limit[2 * eye], abs(second) / limit[2 * eye + 1])
        velocities_in_out[2 * eye], velocities_in_out[2 * eye + 1] = first / excess, second / excess
        if eye == 0:
            excess_l = excess
        else:
            excess_r = excess
    return excess_l, excess_r


@kernel(_LAW_TYPES, _LAW_SHAPES)
def ibvs_command(
    q: FloatArray, pixel_error: FloatArray, gain: FloatArray, depth_m: FloatArray,
    limit: FloatArray, p: PackedHead, out: FloatArray,
) -> None:  # fmt: skip
    """Compute joint velocities from pixel errors; a `depth_m` of nan is triangulated."""
    for eye in range(2):
        for axis in range(2):
            out[2 * eye + axis] = -gain[eye, axis] * pixel_error[eye, axis]
    limited_joint_velocities(p, q, pixel_error, depth_m[0], limit, out)


class TunedIBVS(GatedImageController):
    """The law of `IBVS` with the best fixed gain of a scenario, as a `GatedImageController`.

    Args:
        head: the model of the head.
        layout: the layout of observations and actions.
        scenario: scenario for which the gain was found.
        gain: see `IBVS`; None for the gain found for this head in the scenario, or, if there is
            none, for the scenario's own head.
        depth, speed_limit: see `IBVS`.

    Attributes:
        tuned: True if the gain was found for this head; False also for a given gain.

    Raises:
        UnknownNameError: no gain has been found for this scenario.
        ConfigurationError: an option has an invalid value.
    """

    def __init__(
        self, *, head: HeadModel, layout: ObservationLayout,
        scenario: str = "workspace", gain: ArrayLike | None = None,
        depth: Depth = "triangulated", speed_limit: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__(head=head, layout=layout)
        if not isinstance(scenario, str):
            raise ConfigurationError(f"scenario: expected a name, got {scenario!r:.80}")
        self.scenario = scenario
        self.tuned = False
        if gain is None:
            entry = find_tuned_or_fallback("ibvs-tuned", scenario, head)
            if entry is None:
                known = {key.scenario for key in shipped_table() if key.controller == "ibvs"}
                raise UnknownNameError("scenario", scenario, sorted(known))
            self.tuned = is_tuned_for(entry, head)
            gain = entry.options.get("gain", np.nan)
        self.law = IBVS(head=head, layout=layout, gain=gain, depth=depth, speed_limit=speed_limit)

    @property
    def gain(self) -> FloatArray:
        """(2, 2) gains by eye and image axis, 1/s."""
        return self.law.gain

    def command(self, q: ArrayLike, pixel_error: ArrayLike) -> FloatArray:
        """Compute the law's velocities, see `IBVS.command`."""
        return self.law.command(q, pixel_error)

    def _law(self, detections: GatedDetections, own: FloatArray) -> FloatArray:
        return self.law.command(detections.positions_at_exposure, detections.pixel_error)

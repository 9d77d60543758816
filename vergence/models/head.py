"""HeadModel: the single source of truth on a head's geometry, cameras, limits and timing."""

import dataclasses
import hashlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import hypot
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, VergenceWarning
from vergence.models import fixation, kinematics
from vergence.models.camera import Cameras
from vergence.models.geometry import (
    Geometry,
    JointAxes,
    Links,
    Parameters,
    combine_geometries,
    geometry_with,
    inverse_pose,
    multiply_poses,
    parameters_of,
)
from vergence.models.lens import BROWN_CONRADY, LENSES
from vergence.models.parts import (
    EYES,
    Actuation,
    Actuators,
    CalibrationRecord,
    FloatArray,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
    assemble_actuation,
    is_name_tuple,
    replace_fields,
)
from vergence.models.perturbation import ModelErrors, perturb_geometry
from vergence.operands import as_operand

_TWO, _FOUR = np.zeros(2), np.zeros(4)
"""Operands for the dimensions that a kernel has in its result alone (numerical)."""
_MM_PER_M: Final = 1000.0  # millimetres per metre (physical: the unit)
_ROUNDING_RAD: Final = 1e-9  # tolerance for angles at their limits, rad (numerical)


def _warn_of_point(head: "HeadModel", point: ArrayLike, q: FloatArray) -> None:
    """Warn of a point in millimetres or out of reach.

    No disparity tells a point beyond `far_m` from one at infinity; beyond 1000 times that it is
    taken for a star, and not for a point in millimetres.
    """
    x, y, z = np.asarray(point, dtype=np.float64).tolist()
    far_m, _eyes = head._bounds
    if far_m < hypot(x, y, z) < _MM_PER_M * far_m:
        said = (
            f"metres, got ({x:g}, {y:g}, {z:g}), which is {hypot(x, y, z):.3g} m away, where no "
            f"eye of this head tells how far (from {far_m:.0f} m on): is it in millimetres?"
        )
    elif beyond := describe_beyond_limits(head, q):
        said = f"a point that the eyes can turn to, got ({x:g}, {y:g}, {z:g}) m, for which {beyond}"
    else:
        return
    warnings.warn(f"fixate: points: expected {said}", VergenceWarning, stacklevel=3)


def describe_beyond_limits(head: "HeadModel", q: FloatArray) -> str:
    """Phrase on the first actuator or joint of the eyes whose limits (7,) q breaks; or empty."""
    angles = q.tolist()[EYES]  # floats, which are compared faster than arrays
    if not head.actuation.direct:
        angles = head.actuation.actuators_of(q).tolist()[EYES][: head.actuation.count] + angles
    for (name, low, high), angle in zip(head._bounds[1], angles, strict=False):
        if angle < low - _ROUNDING_RAD or angle > high + _ROUNDING_RAD:
            low, angle, high = np.rad2deg([low, angle, high])
            return f"{name} would be at {angle:.1f} degrees, outside {low:.1f} to {high:.1f}"
    return ""


FORM_VERSION: Final = 1
"""Version of the digest's form (numerical), in which bundles and tuned options name their head.

Of each part, for each field by name: the text `part.field(shape)`, then little-endian float64; text
as Python prints its tuple. Names, assumptions and the calibration record are left out, and fields
added later where they have their default. Fields keep their first names, so a renamed one is
translated: a latency of whole control periods is `timing.latency_frames`, and two Brown-Conrady
cameras of one size have `cameras.width` and `cameras.height`. Any other change needs a new version,
and support for both at once.
"""
_WHOLE_PERIODS_TOLERANCE: Final = 1e-9
"""Tolerance for a whole number of control periods (numerical)."""
_POSE_DECIMALS: Final = 12
"""Decimals kept of a `JointAxes` head's poses, whose last bits differ by machine (numerical)."""
_ZERO_DISPARITY_PX: Final = 0.5
"""Disparity below which a point looks as if at infinity, px: it rounds to 0 (chosen)."""
_COUPLING_TOLERANCE_RAD: Final = 1e-9
"""Tolerance for the angles of coupled joints and for their limits, rad (numerical)."""


def _numbers(part: Any) -> dict[str, Any]:
    """Fields of a part, but those that were added after version 1 and have their default value."""
    kept = {}
    for field in dataclasses.fields(part):
        value, default = getattr(part, field.name), field.default
        if default is dataclasses.MISSING or not np.array_equal(value, default):
            kept[field.name] = value
    kept.pop("names", None)
    return kept


def _camera_numbers(cameras: Cameras) -> dict[str, Any]:
    numbers = {name: getattr(cameras, name) for name in ("focal", "principal", "distortion")}
    left, right = cameras.size.tolist()
    if left == right and set(cameras.lens) == {BROWN_CONRADY}:
        numbers |= dict(zip(("width", "height"), left, strict=True))
    else:
        lens = [1 + list(LENSES).index(lens) for lens in cameras.lens]
        numbers |= {"size": cameras.size, "lens": lens}
    if cameras.response != (None, None):
        numbers["response"] = str(cameras.response)
    return numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadModel:
    """A binocular head: links, eyes, cameras, limits, timing, sensors and actuators.

    Frames: `N` is fixed to the body that the neck's last joint carries, x right, y down, z
    forward; every point that the package computes is in `N`. `C_l` and `C_r` are the cameras, x
    along u, y along v, z along the optical axis. `T_N_Cl` maps coordinates in `C_l` to `N`.

    Arrays of joint angles always have seven entries, three for the neck and two for each eye, see
    `vergence.models.parts`. A joint that the head does not have has an empty name and limits of
    zero, and its angle is ignored. `actuation` holds the actuators that take commands.

    The geometry (`links`, `cameras`) may carry a batch shape, which every method broadcasts with
    the arguments' leading shapes.

    Examples:
        Eyes that look at a point 1 m ahead see it at their principal points:

        >>> import numpy as np, vergence
        >>> head = vergence.load_head("simulated")
        >>> q = head.fixate([0.0, -0.1, 1.0])
        >>> np.rad2deg(q).round(2)
        array([ 0.  ,  0.  ,  0.  , -4.04, -2.59,  4.04,  2.73])
        >>> head.project(q, [0.0, -0.1, 1.0]).round(2)
        array([[520.5, 430.5],
               [520.5, 430.5]])
    """

    name: str
    links: Links
    """Joint axes: `DenavitHartenberg` or `JointAxes`."""
    cameras: Cameras
    limits: JointLimits
    timing: LoopTiming
    sensor: SensorModel
    rendering: Rendering
    actuators: Actuators | None = None
    """Actuators of the eyes' joints; None if each joint has its own motor."""
    assumptions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Assumed (not measured) values: keys of the head's file, and the reason for each value."""
    calibration: CalibrationRecord | None = None
    """Record of the cameras' calibration; None if the file has none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "assumptions", MappingProxyType(dict(self.assumptions)))

    @cached_property
    def packed(self) -> FloatArray:
        """(..., PACKED): the geometry as one packed array per head, for compiled kernels."""
        poses = self.links.constant_poses()
        for eye, camera in enumerate(self.cameras):
            poses[6 + 3 * eye] = poses[6 + 3 * eye] @ camera.pose
        return kinematics.pack_constants(poses, self.cameras.rows, self.actuation)

    @cached_property
    def actuation(self) -> Actuation:
        """Actuators that take commands: the neck's joints and the actuators of the eyes."""
        return assemble_actuation(self)

    @cached_property
    def head_eye(self) -> FloatArray:
        """(..., 2, 4, 4) the cameras' poses in the eyes' last links, T_6_Cl and T_9_Cr, metres."""
        return self.cameras.pose

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """(7,) names in joint order; empty for a missing joint, twice for one of both eyes."""
        return self.links.joints

    @property
    def has_fixed_pair(self) -> bool:
        """True if no joint turns one eye alone, so that the eyes cannot converge."""
        return self.joints[3:5] == self.joints[5:]

    @cached_property
    def _missing(self) -> NDArray[np.intp]:
        """Indices of the joints that the head does not have."""
        return np.flatnonzero([not name for name in self.joints])

    def _held(self, q: ArrayLike) -> ArrayLike:
        """Joint angles with zeros for the joints that the head does not have."""
        if not len(self._missing):
            return q
        held = as_operand("q", q, 7).copy()
        held[..., self._missing] = 0.0
        return held

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """The leading shape of the geometry, () for one head."""
        return self.packed.shape[:-1]

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the head's numbers, 64 hexadecimal digits; its form is `FORM_VERSION`."""
        sha = hashlib.sha256()
        parts = {
            "links": _numbers(self.links),
            "head_eye": {"": self.head_eye},
            "cameras": _camera_numbers(self.cameras),
        }
        for name in ("limits", "timing", "sensor", "rendering", "actuators"):
            if part := getattr(self, name):
                parts[name] = _numbers(part)
        timing = self.timing
        periods = timing.latency_s * timing.control_rate_hz
        if abs(periods - timing.latency_frames) < _WHOLE_PERIODS_TOLERANCE:
            parts["timing"]["latency_frames"] = timing.latency_frames
            del parts["timing"]["latency_s"]
        for part, numbers in parts.items():
            rounds = part in ("links", "head_eye") and isinstance(self.links, JointAxes)
            for field, value in sorted(numbers.items()):
                if is_name_tuple(value) or isinstance(value, str):
                    sha.update(f"{part}.{field}{value}".encode())
                else:
                    array = np.asarray(value, dtype="<f8")
                    if rounds:
                        array = np.round(array, _POSE_DECIMALS) + 0.0  # without negative zeros
                    sha.update(f"{part}.{field}{array.shape}".encode() + array.tobytes())
        return sha.hexdigest()

    def __eq__(self, other: object) -> bool:
        """True if two heads have the same name and the same digest."""
        if not isinstance(other, HeadModel):
            return NotImplemented
        return self.name == other.name and self.digest == other.digest

    def __hash__(self) -> int:
        return hash((self.name, self.digest))

    def __getstate__(self) -> dict[str, Any]:
        state = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return state | {"assumptions": dict(self.assumptions)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state | {"assumptions": MappingProxyType(state["assumptions"])})

    def __getitem__(self, index: Any) -> "HeadModel":
        """Select one head, or several, of a population."""

        def picked(arrays: Sequence[FloatArray], own: int) -> FloatArray:
            (values,) = arrays
            full = np.broadcast_to(values, (*self.batch_shape, *values.shape[values.ndim - own :]))
            return np.asarray(full[index])

        return self._with(combine_geometries([self.geometry], picked))

    @staticmethod
    def stack(heads: Sequence["HeadModel"]) -> "HeadModel":
        """Stack heads to a population; everything except the geometry is taken from the first.

        Raises:
            ConfigurationError: there is none, or they differ in lens models, joints or batch shape.
        """
        if not heads:
            raise ConfigurationError("stack: expected one head or more, got none")
        for name, own in (
            ("lenses", [head.cameras.lens for head in heads]),
            ("joints", [head.joints for head in heads]),
            ("batch shape", [head.batch_shape for head in heads]),
        ):
            if any(each != own[0] for each in own):
                raise ConfigurationError(
                    f"stack: expected heads with the {name} of the first, {own[0]}, got {own!r:.80}"
                )
        geometries = [head.geometry for head in heads]
        return heads[0]._with(combine_geometries(geometries, lambda arrays, own: np.stack(arrays)))

    def _with(self, geometry: Geometry) -> "HeadModel":
        # the calibration record does not apply to another geometry
        return dataclasses.replace(self, **geometry._asdict(), calibration=None)

    def replace(self, **parts: Any) -> "HeadModel":
        """A copy with some parts, or fields of parts, changed.

        Args:
            **parts: new values by field, or a dict of the fields of that part to change:
                `head.replace(timing={"lag_s": 0.0})`.

        Raises:
            ConfigurationError: a field is unknown, or a value is invalid.
        """
        if isinstance(cameras := parts.get("cameras"), Mapping):
            parts["cameras"] = self.cameras.replaced(**cameras)
        if "head_eye" in parts:
            pose = parts.pop("head_eye")
            parts["cameras"] = parts.get("cameras", self.cameras).replaced(pose=pose)
        if {"links", "cameras"} & set(parts):
            parts.setdefault("calibration", None)  # the record does not apply to another geometry
        copy: HeadModel = replace_fields(self, "head", parts)
        return copy

    def base_pose(self, q: ArrayLike) -> FloatArray:
        """(..., 4, 4) pose of frame N in the base frame 0, T_0_N, metres.

        Args:
            q: (..., 7) joint angles, rad.
        """
        return np.asarray(kinematics.base_pose(self._held(q), self.packed, _FOUR))

    def camera_poses(self, q: ArrayLike) -> FloatArray:
        """(..., 2, 4, 4) poses of both cameras in N, T_N_Cl and T_N_Cr, metres (Eqs. 14 to 17).

        Args:
            q: (..., 7) joint angles, rad.
        """
        return np.asarray(kinematics.camera_poses(self._held(q), self.packed, _TWO, _FOUR))

    def link_poses(self, q: ArrayLike) -> FloatArray:
        """(..., 2, 4, 4) poses in N of the last links of both eyes, T_N_6 and T_N_9, metres.

        These carry the cameras: `camera_poses(q) = link_poses(q) @ head_eye`.

        Args:
            q: (..., 7) joint angles, rad.
        """
        return multiply_poses(self.camera_poses(q), inverse_pose(self.head_eye))

    def project(self, q: ArrayLike, points: ArrayLike, distorted: bool = True) -> FloatArray:
        """(..., 2, 2) pixels of points by eye, not clipped to the image.

        They are nan behind a camera and beyond the radius at which the lens model folds back.

        Args:
            q: (..., 7) joint angles, rad.
            points: (..., 3) in N, metres.
            distorted: True for raw pixels, False for pixels of the ideal pinhole.
        """
        q, raw = self._held(q), np.bool_(distorted)
        return np.asarray(kinematics.project(q, points, raw, self.packed, _TWO))

    def undistort(self, pixels: ArrayLike) -> FloatArray:
        """(..., 2, 2) pixels of the ideal pinhole; nan where the lens model has no inverse.

        Args:
            pixels: (..., 2, 2) raw pixels by eye.
        """
        return np.asarray(kinematics.undistort(pixels, self.packed))

    def image_jacobian(self, q: ArrayLike, pixels: ArrayLike, depth: ArrayLike) -> FloatArray:
        """(..., 2, 2, 7) pixel velocity per joint velocity of a target at rest in frame 0 (Eq. 6).

        In px/rad by eye, image axis and joint; zero for the joints of the other eye.

        Args:
            q: (..., 7) joint angles, rad.
            pixels: (..., 2, 2) ideal (undistorted) pixels.
            depth: (..., 2) the target's z in each camera frame, metres.
        """
        out = np.asarray(kinematics.image_jacobian(self._held(q), pixels, depth, self.packed))
        out[..., self._missing] = 0.0
        return out

    def fixate(self, points: ArrayLike, neck: ArrayLike = 0.0, *, warn: bool = True) -> FloatArray:
        """(..., 7) joint angles, rad, that put points on both optical axes; nan without a solution.

        Where coupled joints allow no exact solution, the angles minimise the sum of squared pixel
        errors; `least_error` returns the residual. Limits are not applied; `reaches` checks them.

        Args:
            points: (..., 3) in N, metres.
            neck: (..., 3) or a scalar, the neck's angles, rad; N moves with the neck.
            warn: True to issue a `VergenceWarning` for a single point (never for several) that
                seems to be in millimetres or is beyond the limits of the eyes.

        Raises:
            ConfigurationError: the eyes do not move.
        """
        if not self.actuation.count:
            raise ConfigurationError(
                f"fixate: expected a head whose eyes move, got {self.name!r}, a fixed pair"
            )
        points, neck = as_operand("fixate: points", points, 3), as_operand("fixate: neck", neck)
        neck = as_operand("fixate: neck", np.broadcast_to(neck, neck.shape or (3,)), 3)
        with np.errstate(invalid="ignore"):  # a point at infinity has no solution: not an error
            kernel = fixation.fixate if self.actuation.direct else fixation.fixate_least_squares
            q = np.asarray(kernel(points, neck, np.zeros(7), self.packed))
        if warn and q.ndim == 1:  # a program that asks for many points checks the angles itself
            _warn_of_point(self, points, q)
        return q

    @cached_property
    def _bounds(self) -> tuple[float, list[tuple[str, float, float]]]:
        """Distance beyond which no disparity tells one, m, and names and least and greatest angles.

        The angles, rad, are those of the eyes' actuators, then of their joints.
        """
        left, right = self.camera_poses(self.rest())[:, :3, 3]
        baseline_m, focal_px = np.linalg.norm(right - left), self.cameras.focal.max()
        far_m = float(baseline_m) * float(focal_px) / _ZERO_DISPARITY_PX
        eyes: list[tuple[str, float, float]] = []
        own = self.actuation
        for names, ends in ((own.names, own), (self.joints[EYES], self.limits)):
            eyes += zip(names, ends.lower[EYES].tolist(), ends.upper[EYES].tolist(), strict=False)
        return far_m, eyes

    def perturbed(
        self,
        rng: np.random.Generator,
        errors: ModelErrors,
        size: int | tuple[int, ...] | None = None,
    ) -> "HeadModel":
        """Draw heads whose geometry differs from this one by random errors.

        Args:
            rng: the source of randomness.
            errors: standard deviations of the errors.
            size: the population's shape, the batch shape of its geometry; None for one head.

        Raises:
            ConfigurationError: this head is a population already, or the size has a count below 1.
        """
        if self.batch_shape:
            raise ConfigurationError(
                f"perturbed: expected one head, got a population of shape {self.batch_shape}"
            )
        shape = () if size is None else (size,) if isinstance(size, int) else tuple(size)
        if min(shape, default=1) < 1:
            raise ConfigurationError(f"size: expected counts of 1 or more, got {size!r:.80}")
        return self._with(perturb_geometry(self.geometry, rng, errors, shape))

    def least_error(self, points: ArrayLike) -> FloatArray:
        """(..., 2, 2) residual of `fixate` by eye and image axis: ideal pixel less principal point.

        Zero for one head whose eye joints all have their own motors, nan without a solution.

        Args:
            points: (..., 3) in N, metres.
        """
        points = as_operand("least_error: points", points, 3)
        if self.actuation.direct and not self.batch_shape:
            return np.zeros((*points.shape[:-1], 2, 2))
        pixels = self.project(self.fixate(points, warn=False), points, distorted=False)
        return np.asarray(pixels - self.cameras.principal)

    def reaches(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """(...) True if joint angles are within all limits and possible for coupled joints.

        Args:
            q: (..., 7) joint angles, rad; False for nan.
            margin: the distance that actuators keep from their limits, rad.
        """
        q = as_operand("reaches: q", self._held(q), 7)
        actuation = self.actuation
        if actuation.direct and not len(self._missing):
            return self.limits.contains(q, margin)
        own = actuation.actuators_of(q)
        tied = np.abs(actuation.joints_of(own) - q).max(axis=-1) < _COUPLING_TOLERANCE_RAD
        keep = np.where(actuation.upper > actuation.lower, margin, -_COUPLING_TOLERANCE_RAD)
        inside = (own >= actuation.lower + keep) & (own <= actuation.upper - keep)
        contained = self.limits.contains(q, -_COUPLING_TOLERANCE_RAD)
        return np.asarray(tied & inside.all(axis=-1) & contained)

    @property
    def geometry(self) -> Geometry:
        """Parts in which a real head differs from its model: links, head-eye, cameras."""
        return Geometry(self.links, self.cameras)

    def parameters(self, about: "HeadModel | None" = None) -> Parameters:
        """Names such as `left.tilt.alpha`, units, and (..., n) values of the geometry's numbers.

        Args:
            about: the head that rotation vectors are relative to; None for this one: zeros.

        Raises:
            ConfigurationError: that head has other joints.
        """
        return parameters_of(self.geometry, None if about is None else about.geometry)

    def with_parameters(self, values: ArrayLike) -> "HeadModel":
        """Rebuild a head from its vector: `about.with_parameters(head.parameters(about).values)`.

        Args:
            values: (..., n) in the order of `parameters`, rotation vectors relative to this head;
                the neck, limits, timing and sensors stay.

        Raises:
            ConfigurationError: the vector has the wrong length.
        """
        return self._with(geometry_with(self.geometry, values))

    def rest(self) -> FloatArray:
        """(7,) joint angles with all actuators at zero, or at the limit nearest to zero, rad."""
        actuation = self.actuation
        return actuation.joints_of(np.clip(np.zeros(7), actuation.lower, actuation.upper))

    def camera_in_last_link(self, eye: int) -> FloatArray:
        """(4, 4) pose of an eye's camera in the frame of the last body of its chain, metres."""
        return np.asarray(self.links.camera_mount(eye) @ self.head_eye[eye])

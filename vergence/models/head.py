"""HeadModel: what a head is, the one source of truth of everything that moves or looks."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError
from vergence.models import camera, fixation, jacobian, kinematics, population
from vergence.models.actuation import Actuation, Actuators, actuation_of
from vergence.models.calibrated import CalibrationRecord
from vergence.models.cameras import Cameras
from vergence.models.digest import digest_of
from vergence.models.links import Links
from vergence.models.mistaken import Bounds, warn_of_point
from vergence.models.parameters import Geometry, Parameters, geometry_with, parameters_of
from vergence.models.parts import (
    FloatArray,
    JointLimits,
    LoopTiming,
    Rendering,
    SensorModel,
    frozen_array,
    replaced,
)
from vergence.models.perturbation import ModelErrors, perturb_geometry
from vergence.operands import as_operand

_TIED_RAD: Final = 1e-9
"""What rounding may leave between the angles of tied joints."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadModel:
    """A binocular head: links, eyes, cameras, limits, timing, sensors and actuators.

    Frames (spec): `N` is fixed to what the neck's last joint carries, x right, y down, z forward,
    and holds every point the package computes; `C_l` and `C_r` are the cameras, x along u, y along
    v, z along the optical axis. `T_N_Cl` maps coordinates in `C_l` to coordinates in `N`.

    Joint angles are always seven: three of the neck, and two of either eye, see
    `vergence.models.joints`. A joint that a head does not have has no name in `joints`, limits of
    zero, and an angle that counts for nothing. What can be commanded is `actuation`.

    The geometry (`links`, `head_eye`, `cameras`) may carry a batch shape; every method then
    broadcasts it with the arguments' leading shapes by NumPy's rules.
    """

    name: str
    links: Links
    """Where the joints' axes are: `DenavitHartenberg` or `JointAxes`."""
    head_eye: FloatArray
    """(..., 2, 4, 4): the cameras in the eyes' last links, T_6_Cl and T_9_Cr."""
    cameras: Cameras
    limits: JointLimits
    timing: LoopTiming
    sensor: SensorModel
    rendering: Rendering
    actuators: Actuators | None = None
    """What moves the eyes' joints; None where each of them has its own motor."""
    assumptions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """What nobody has measured, by the key of the head's file, and why it has that value."""
    calibration: CalibrationRecord | None = None
    """How the cameras were calibrated; None where the file does not say."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "head_eye", frozen_array(self.head_eye))
        object.__setattr__(self, "assumptions", MappingProxyType(dict(self.assumptions)))

    @cached_property
    def packed(self) -> FloatArray:
        """(..., PACKED): the geometry folded into a row of numbers for compiled kernels."""
        return kinematics.pack_head(self.links, self.head_eye, self.cameras, self.actuation)

    @cached_property
    def actuation(self) -> Actuation:
        """What can be commanded: the actuators of the eyes, and the neck's joints."""
        return actuation_of(self.joints, self.limits, self.timing, self.sensor, self.actuators)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """(7,) names in joint order; empty for a joint that the head does not have.

        A joint that both eyes share stands in two places.
        """
        return self.links.joints

    @cached_property
    def _missing(self) -> NDArray[np.intp]:
        """The joints that the head does not have."""
        return np.flatnonzero([not name for name in self.joints])

    def _held(self, q: ArrayLike) -> ArrayLike:
        """Joint angles with those that count for nothing at zero."""
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
        """SHA-256 over every number of the head, in hexadecimal; the name is not part of it."""
        return digest_of(self)

    def __eq__(self, other: object) -> bool:
        """Whether two heads have the same name and the same numbers."""
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
        """One head, or several, of a population."""
        return self._with(population.pick(self.geometry, self.batch_shape, index))

    @staticmethod
    def stack(heads: Sequence["HeadModel"]) -> "HeadModel":
        """A population of heads of the same shape; all but the geometry is the first one's.

        Raises:
            ConfigurationError: their lenses or their joints differ in kind.
        """
        return heads[0]._with(population.stack([head.geometry for head in heads]))

    def _with(self, geometry: Geometry) -> "HeadModel":
        # another geometry is not what was calibrated
        return dataclasses.replace(self, **geometry._asdict(), calibration=None)

    def replace(self, **parts: Any) -> "HeadModel":
        """A copy with some parts, or fields of parts, changed.

        Args:
            **parts: a field of this class with its new value, or with a dict of the
                fields of that part to change: `head.replace(timing={"lag_s": 0.0})`.

        Returns:
            The new head.

        Raises:
            ConfigurationError: a field is unknown, or a number cannot be.
        """
        if {"links", "head_eye", "cameras"} & set(parts):
            parts = {"calibration": None} | parts  # another geometry is not what was calibrated
        return replaced(self, "head", parts)

    def base_pose(self, q: ArrayLike) -> FloatArray:
        """Where the neck has carried frame N.

        Args:
            q: (..., 7) joint angles, rad.

        Returns:
            (..., 4, 4) T_0_N, metres.
        """
        return np.asarray(kinematics.base_pose(self._held(q), self.packed, kinematics.QUAD))

    def camera_poses(self, q: ArrayLike) -> FloatArray:
        """Where the cameras are (Eqs. 14 to 17).

        Args:
            q: (..., 7) joint angles, rad.

        Returns:
            (..., 2, 4, 4) T_N_Cl and T_N_Cr, metres.
        """
        q = self._held(q)
        return np.asarray(kinematics.camera_poses(q, self.packed, kinematics.PAIR, kinematics.QUAD))

    def link_poses(self, q: ArrayLike) -> FloatArray:
        """Where the last links of both eyes are, which carry the cameras.

        They are what the joints place alone: `camera_poses(q) = link_poses(q) @ head_eye`.

        Args:
            q: (..., 7) joint angles, rad.

        Returns:
            (..., 2, 4, 4) T_N_6 and T_N_9, metres.
        """
        return np.asarray(kinematics.link_poses(self._held(q), self.packed, self.head_eye))

    def project(self, q: ArrayLike, points: ArrayLike, distorted: bool = True) -> FloatArray:
        """Where points appear in both images.

        Args:
            q: (..., 7) joint angles, rad.
            points: (..., 3) in N, metres.
            distorted: raw pixels if True, those of the ideal pinhole if False.

        Returns:
            (..., 2, 2) pixels, not clipped to the image; nan behind a camera and beyond
            the radius at which the lens model folds back on itself.
        """
        return np.asarray(
            camera.project(self._held(q), points, np.bool_(distorted), self.packed, kinematics.PAIR)
        )

    def undistort(self, pixels: ArrayLike) -> FloatArray:
        """Raw pixels to those of the ideal pinhole with the same focal length and centre.

        Args:
            pixels: (..., 2, 2) raw pixels.

        Returns:
            (..., 2, 2) ideal pixels; nan where the lens model has no inverse.
        """
        return np.asarray(camera.undistort(pixels, self.packed))

    def image_jacobian(self, q: ArrayLike, pixels: ArrayLike, depth: ArrayLike) -> FloatArray:
        """Pixel velocity per joint velocity, of a target at rest in frame 0 (Eq. 6).

        Args:
            q: (..., 7) joint angles, rad.
            pixels: (..., 2, 2) ideal (undistorted) pixels.
            depth: (..., 2) the target's z in each camera frame, metres.

        Returns:
            (..., 2, 2, 7) px/rad by eye, image axis, joint; an eye does not see the
            other's joints.
        """
        out = np.asarray(jacobian.image_jacobian(self._held(q), pixels, depth, self.packed))
        out[..., self._missing] = 0.0
        return out

    def fixate(self, points: ArrayLike, neck: ArrayLike = 0.0, *, warn: bool = True) -> FloatArray:
        """The joint angles that put points on both optical axes.

        Where actuators tie the joints so that no angles do that exactly, as for a common tilt of
        eyes that are not quite level, those with the least sum of squared pixel errors;
        `least_error` tells what is left. Limits are not applied; `reaches` tells whether
        the angles can be reached.

        Args:
            points: (..., 3) in N, metres.
            neck: (..., 3) or a scalar, the neck's angles, rad, which N moves with.
            warn: whether a `VergenceWarning` says of one point, never of several, that it looks
                like millimetres or that the eyes cannot turn so far.

        Returns:
            (..., 7) joint angles, rad; nan for an eye that no angles make look there.

        Raises:
            ConfigurationError: the eyes do not move.
        """
        if not self.actuation.count:
            raise ConfigurationError(
                f"fixate: expected a head whose eyes move, got {self.name!r}, a fixed pair"
            )
        neck = as_operand("fixate: neck", neck)
        neck = np.broadcast_to(neck, (3,)) if neck.ndim == 0 else neck
        with np.errstate(invalid="ignore"):  # a point at infinity has no angles, which is no fault
            kernel = fixation.fixate if self.actuation.direct else fixation.fixate_best
            q = np.asarray(kernel(points, neck, np.zeros(7), self.packed))
        if warn and q.ndim == 1:  # many points are a program's, which judges the angles itself
            warn_of_point(self._bounds, points, q)
        return q

    @cached_property
    def _bounds(self) -> Bounds:
        left, right = self.camera_poses(self.rest())[:, :3, 3]
        baseline, focal = float(np.linalg.norm(right - left)), float(self.cameras.focal.max())
        return Bounds.of(self.joints, self.limits, self.actuation, baseline, focal)

    def perturbed(
        self,
        rng: np.random.Generator,
        errors: ModelErrors,
        size: int | tuple[int, ...] | None = None,
    ) -> "HeadModel":
        """Draw heads that differ from this one by random errors of their geometry.

        Args:
            rng: the source of randomness.
            errors: standard deviations of the errors.
            size: the population's shape; None for one head.

        Returns:
            A head whose geometry has the batch shape `size`; its limits, timing and sensors
            are this one's.

        Raises:
            ConfigurationError: this is a population already.
        """
        if self.batch_shape:
            raise ConfigurationError(
                f"perturbed: expected one head, got a population of shape {self.batch_shape}"
            )
        shape = () if size is None else (size,) if isinstance(size, int) else tuple(size)
        return self._with(perturb_geometry(self.geometry, rng, errors, shape))

    def least_error(self, points: ArrayLike) -> FloatArray:
        """What is left of the pixel errors at best, see `fixate`.

        Args:
            points: (..., 3) in N, metres.

        Returns:
            (..., 2, 2) ideal pixel less principal point by eye and image axis, px; zero for a head
            that fixates exactly, nan where `fixate` has no answer.
        """
        points = as_operand("least_error: points", points, 3)
        if self.actuation.direct and not self.batch_shape:
            return np.zeros((*points.shape[:-1], 2, 2))
        pixels = self.project(self.fixate(points, warn=False), points, distorted=False)
        return np.asarray(pixels - self.cameras.principal)

    def reaches(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether the joints, and the actuators that move them, can stand so.

        Args:
            q: (..., 7) joint angles, rad.
            margin: the distance that actuators keep to their limits, rad.

        Returns:
            (...) booleans; False where an angle is nan, or ties between joints do not allow it.
        """
        q = as_operand("reaches: q", self._held(q), 7)
        actuation = self.actuation
        if actuation.direct and not len(self._missing):
            return self.limits.contains(q, margin)
        own = actuation.actuators_of(q)
        tied = np.abs(actuation.joints_of(own) - q).max(axis=-1) < _TIED_RAD
        moves = actuation.upper > actuation.lower
        keep = np.where(moves, margin, -_TIED_RAD)
        inside = (own >= actuation.lower + keep) & (own <= actuation.upper - keep)
        return np.asarray(tied & inside.all(axis=-1) & self.limits.contains(q, -_TIED_RAD))

    @property
    def geometry(self) -> Geometry:
        """What a real head has otherwise than its model says."""
        return Geometry(self.links, self.head_eye, self.cameras)

    def parameters(self, about: "HeadModel | None" = None) -> Parameters:
        """The geometry as a vector of named numbers: axes, head-eye transforms, cameras.

        Args:
            about: the head from which head-eye rotations are counted, as rotation vectors; None
                for this head itself, whose rotation vectors are then zero.

        Returns:
            Names such as `left.tilt.alpha`, units, and values (..., n).
        """
        return parameters_of(self.geometry, None if about is None else about.geometry)

    def with_parameters(self, values: ArrayLike) -> "HeadModel":
        """This head with another geometry: `about.with_parameters(head.parameters(about).values)`.

        Args:
            values: (..., n) in the order of `parameters`, head-eye rotations counted from this
                head's.

        Returns:
            A head with the batch shape of the values. The neck, limits, timing and sensors are
            this one's.

        Raises:
            ConfigurationError: the vector has another length.
        """
        return self._with(geometry_with(self.geometry, values))

    def rest(self) -> FloatArray:
        """(7,) all actuators at zero, or at the limit nearest to it; joint angles, rad."""
        actuation = self.actuation
        return actuation.joints_of(np.clip(np.zeros(7), actuation.lower, actuation.upper))

    def camera_in_last_link(self, eye: int) -> FloatArray:
        """(4, 4) an eye's camera in the frame of the last body of its chain, metres."""
        return np.asarray(self.links.camera_mount(eye) @ self.head_eye[eye])

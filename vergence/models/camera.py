"""A camera: image size, pinhole, lens, response and pose; its rays and pixels.

Pixels follow OpenCV: the centre of the upper left pixel is (0, 0), a pixel covers half a pixel to
each side of its centre, and u = u_0 + f_u x / z.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vergence.errors import ConfigurationError, refuse_unknown
from vergence.kernels import kernel
from vergence.models.lens import (
    BROWN_CONRADY,
    CAMERA_LENGTH,
    LENSES,
    camera_at,
    distort,
    is_distorted,
    pack_camera,
    pinhole_ray,
    ray_to_pixel,
    undistort_ray,
)
from vergence.models.parts import EYE_NAMES, FloatArray, Parameter, readonly_array
from vergence.operands import as_operand

CameraResponse = str | float | tuple[float, ...]
"""Response: ``"linear"``, ``"srgb"``, a gamma, or a table, see `parse_response`."""
LINEAR: Final = "linear"
SRGB: Final = "srgb"
EXPECTED: Final = (
    "'linear', 'srgb', a gamma from 0.2 to 5 such as 2.2 (light is the level's share to that "
    "power), or a table of the light at levels in equal steps, rising from 0 to 1"
)
"""Description of a valid response, for messages."""
_GAMMA_RANGE: Final = (0.2, 5.0)
"""Least and greatest gamma; those of cameras and displays lie between 1 and 2.6 (chosen: far
beyond)."""
_LEVELS: Final = 256  # grey levels of 8 bits (numerical)
_MOST_ENTRIES: Final = 65536  # most entries of a table, one for each level of 16 bits (numerical)


def parse_response(value: Any, name: str = "response") -> CameraResponse:
    """Parse a response from a file, an option or a caller.

    Args:
        value: ``"linear"``: levels are proportional to light. ``"srgb"``: the curve of
            IEC 61966-2-1, which JPEG files, webcams and displays follow. A number g: light is the
            level, as a fraction of the greatest, to the power of g. A table: at least two numbers,
            the light at equally spaced levels from 0 to the greatest, rising from 0 to 1. A number
            or a table may also be given as a string, with commas between a table's numbers.
        name: name of the value in messages.

    Raises:
        ConfigurationError: the value is none of these.
    """
    if isinstance(value, str):
        if value.lower() in (LINEAR, SRGB):
            return value.lower()
        with suppress(ValueError):
            numbers = [float(part) for part in value.split(",")]
            value = numbers if len(numbers) > 1 else numbers[0]
    got = f"{value!r:.80}"
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        gamma, got = float(value), f"{float(value):g}"
        if _GAMMA_RANGE[0] <= gamma <= _GAMMA_RANGE[1]:
            return LINEAR if gamma == 1.0 else gamma
    else:
        try:
            table = np.asarray(value, float)
        except (TypeError, ValueError):
            table = np.empty(0)
        listed = table.ndim == 1 and len(table) > 1
        plain = listed and not any(isinstance(x, str | bool | np.bool_) for x in value)
        rises = plain and len(table) <= _MOST_ENTRIES and (np.diff(table) > 0.0).all()
        if rises and table[0] == 0.0 and table[-1] == 1.0:
            return tuple(table.tolist())
    raise ConfigurationError(f"{name}: expected {EXPECTED}, got {got}")


def default_response(*, colour: bool) -> CameraResponse:
    """Response if none is stated: sRGB for colour, linear for grey, from industry or rendering."""
    return SRGB if colour else LINEAR


def to_light(grey_fraction: ArrayLike, response: CameraResponse) -> FloatArray:
    """Convert grey levels to light, both as fractions of the greatest, 0 to 1."""
    grey_fraction = np.asarray(grey_fraction, np.float64)
    if response == LINEAR:
        return grey_fraction
    if response == SRGB:  # IEC 61966-2-1
        return np.where(
            grey_fraction <= 0.04045,
            grey_fraction / 12.92,
            ((grey_fraction + 0.055) / 1.055) ** 2.4,
        )
    if isinstance(response, tuple):
        return np.asarray(np.interp(grey_fraction, np.linspace(0.0, 1.0, len(response)), response))
    return np.asarray(grey_fraction ** float(response))


@lru_cache(maxsize=32)
def light_table(response: CameraResponse) -> FloatArray:
    """(256,) read-only light of each grey level of 8 bits."""
    light = 255.0 * to_light(np.linspace(0.0, 1.0, _LEVELS), response)
    light.setflags(write=False)
    return light


UNDISTORTED: Final = "pinhole"
"""Name, in files and messages, of a Brown-Conrady lens without distortion."""


class Lens(NamedTuple):
    """Lens model and its coefficients."""

    model: str = BROWN_CONRADY
    """Name of the model, a key of `LENSES`."""
    coefficients: FloatArray | tuple[float, ...] = ()
    """(..., n) in OpenCV's order, see `LENSES`; empty for zeros."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """One camera; the matrix, the coefficients and the pose may carry a batch shape.

    A camera without batch shape is hashable, and equals another one with the same values.

    Raises:
        ConfigurationError: a size or a focal length is not positive, the matrix has a skew, the
            lens or the response is unknown, or the lens has another number of coefficients.
    """

    size: tuple[int, int]
    """(width, height) of the image, in pixels."""
    matrix: FloatArray
    """(..., 3, 3) camera matrix K, in pixels, without skew."""
    lens: Lens = Lens()  # noqa: RUF009 (a constant)
    response: CameraResponse | None = None
    """Light by grey level, see `parse_response`; None if unknown."""
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    """(..., 4, 4) pose in what carries the camera, metres; of an eye, its last link."""

    def __post_init__(self) -> None:
        matrix = readonly_array(self.matrix)
        off = [[0, 1, 0], [1, 0, 0], [1, 1, 1]]
        if matrix.shape[-2:] != (3, 3) or (np.array(off) * (matrix - np.eye(3))).any():
            raise ConfigurationError(
                "matrix: expected a camera matrix of focal lengths and a principal point, shape "
                f"(..., 3, 3), got {matrix.tolist()!r:.80}"
            )
        focal = matrix[..., [0, 1], [0, 1]]
        if not (focal > 0.0).all():
            raise ConfigurationError(
                f"focal: expected positive focal lengths, got {focal.tolist()!r:.80}"
            )
        vars(self).update(
            response=None if self.response is None else parse_response(self.response),
            size=_whole_size(self.size),
            matrix=matrix,
            lens=_checked_lens(*self.lens),
            pose=readonly_array(self.pose),
        )

    @classmethod
    def of(cls, head: Any, eye: int) -> "Camera":
        """Camera of one eye of one head, 0 for left, 1 for right.

        Raises:
            ConfigurationError: the head or the eye is invalid.
        """
        cameras = getattr(head, "cameras", None)
        if not isinstance(cameras, Cameras):
            raise ConfigurationError(f"head: expected a head, see load_head; got {head!r:.80}")
        if eye not in (0, 1):
            raise ConfigurationError(f"eye: expected 0 for left or 1 for right, got {eye!r:.80}")
        return cameras[eye]

    @property
    def width(self) -> int:
        """Image width, in pixels."""
        return self.size[0]

    @property
    def height(self) -> int:
        """Image height, in pixels."""
        return self.size[1]

    @cached_property
    def focal(self) -> FloatArray:
        """(..., 2) focal lengths f_u and f_v, in pixels."""
        return readonly_array(self.matrix[..., [0, 1], [0, 1]])

    @cached_property
    def principal(self) -> FloatArray:
        """(..., 2) principal point (u_0, v_0), in pixels."""
        return readonly_array(self.matrix[..., :2, 2])

    @cached_property
    def inverse_matrix(self) -> FloatArray:
        """(3, 3) inverse of K."""
        (f_u, f_v), (u_0, v_0) = self.focal, self.principal
        return np.array([[1 / f_u, 0, -u_0 / f_u], [0, 1 / f_v, -v_0 / f_v], [0, 0, 1]])

    @cached_property
    def row(self) -> FloatArray:
        """(..., 17) packed camera for kernels, see `camera_at`."""
        return pack_camera(self.size, self.focal, self.principal, *self.lens)

    @cached_property
    def distorts(self) -> bool:
        """True if the lens distorts."""
        return is_distorted(camera_at(self.row, 0))

    @cached_property
    def bends_boards(self) -> bool:
        """True if the lens bends a board's straight lines and changes its scale considerably.

        The Brown-Conrady model is for moderate angles, over which a board is small: for the search
        for cells its image is close enough to a pinhole's.
        """
        return self.lens.model != BROWN_CONRADY and self.distorts

    def project(self, points: ArrayLike) -> FloatArray:
        """Pixels of points in front of the camera, distorted by the lens.

        Args:
            points: points in the camera frame, metres, shape (n, 3), z > 0.

        Returns:
            Pixels, shape (n, 2); nan beyond the radius at which the lens model folds back.
        """
        array = as_operand("points", points, "n", 3)
        return np.asarray(rays_to_pixels(array[:, :2] / array[:, 2:], self.row))

    def rays(self, pixels: ArrayLike) -> FloatArray:
        """Undistorted rays (x / z, y / z) of distorted pixels, shape (n, 2) for (n, 2).

        Rays are nan where the lens model has no inverse.
        """
        return np.asarray(pixels_to_rays(pixels, self.row))

    def distortion_jacobian(self, x: float, y: float) -> FloatArray:
        """(2, 2) derivative of distorted by ideal normalised coordinates at a ray x / z, y / z."""
        distorted = distort(camera_at(self.row, 0), x, y)
        return np.array([[distorted.dxx, distorted.dxy], [distorted.dxy, distorted.dyy]])

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        numbers = (self.matrix.tobytes(), self.lens.coefficients.tobytes(), self.pose.tobytes())  # type: ignore[union-attr]
        return (self.size, self.lens.model, self.response, *numbers)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Camera) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)


def camera_matrix(focal: ArrayLike, principal: ArrayLike) -> FloatArray:
    """(..., 3, 3) camera matrix of (..., 2) focal lengths and principal point, in pixels."""
    focal, principal = np.asarray(focal, np.float64), np.asarray(principal, np.float64)
    matrix = np.zeros((*np.broadcast_shapes(focal.shape, principal.shape)[:-1], 3, 3))
    matrix[..., [0, 1], [0, 1]], matrix[..., :2, 2], matrix[..., 2, 2] = focal, principal, 1.0
    return matrix


@dataclass(frozen=True)
class Cameras:
    """The cameras of a head, with their values stacked by eye."""

    left: Camera
    right: Camera

    def __iter__(self) -> Iterator[Camera]:
        return iter((self.left, self.right))

    def __getitem__(self, eye: int) -> Camera:
        return (self.left, self.right)[eye]

    @cached_property
    def size(self) -> NDArray[np.int64]:
        """(2, 2) (width, height) by eye, in pixels."""
        return np.array([camera.size for camera in self])

    @cached_property
    def focal(self) -> FloatArray:
        """(..., 2, 2) (f_u, f_v) by eye, in pixels."""
        return readonly_array(np.stack([camera.focal for camera in self], axis=-2))

    @cached_property
    def principal(self) -> FloatArray:
        """(..., 2, 2) (u_0, v_0) by eye, in pixels, pixel centres at integers."""
        return readonly_array(np.stack([camera.principal for camera in self], axis=-2))

    @cached_property
    def lens(self) -> tuple[str, str]:
        """Lens model by eye."""
        return self.left.lens.model, self.right.lens.model

    @cached_property
    def distortion(self) -> FloatArray:
        """(..., 2, n) coefficients by eye, padded: n is 5 for two Brown-Conrady lenses, else 8."""
        own = [np.asarray(camera.lens.coefficients) for camera in self]
        batch = np.broadcast_shapes(*(coefficients.shape[:-1] for coefficients in own))
        padded = 5 if self.lens == (BROWN_CONRADY, BROWN_CONRADY) else 8
        out = np.zeros((*batch, 2, padded))
        for eye, coefficients in enumerate(own):
            out[..., eye, : coefficients.shape[-1]] = coefficients
        return readonly_array(out)

    @cached_property
    def response(self) -> tuple[CameraResponse | None, CameraResponse | None]:
        """Response by eye."""
        return self.left.response, self.right.response

    @cached_property
    def pose(self) -> FloatArray:
        """(..., 2, 4, 4) poses in the eyes' last links, T_6_Cl and T_9_Cr, metres."""
        return readonly_array(np.stack([camera.pose for camera in self], axis=-3))

    @cached_property
    def rows(self) -> FloatArray:
        """(..., 2, 17) packed cameras for kernels."""
        return np.stack(np.broadcast_arrays(self.left.row, self.right.row), axis=-2)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of pinhole and lens of both eyes; 18 for two Brown-Conrady lenses."""
        padded = self.distortion.shape[-1]
        return tuple(
            Parameter(f"{eye}.camera.{name}", unit, field, slots * i + j)
            for i, eye in enumerate(EYE_NAMES)
            for field, slots, unit, names in (
                ("focal", 2, "px", ("f_u", "f_v")),
                ("principal", 2, "px", ("u_0", "v_0")),
                ("distortion", padded, "1", LENSES[self.lens[i]]),
            )
            for j, name in enumerate(names)
        )

    def replaced(self, **values: Any) -> "Cameras":
        """Copy with some values changed, each stacked by eye as the properties are.

        One size, lens or response applies to both eyes.

        Raises:
            ConfigurationError: a value is unknown or invalid.
        """
        refuse_unknown("cameras", values, STACKED)
        new: dict[str, Any] = {name: getattr(self, name) for name in STACKED} | values
        if not isinstance(new["lens"], str | tuple | list):
            raise ConfigurationError(f"lens: expected a name for each eye, got {new['lens']!r:.80}")
        if not isinstance(new["lens"], str):
            new["lens"] = tuple(new["lens"])
        lens, response = (  # one that is no pair applies to both
            given if isinstance(given, tuple) and len(given) == 2 else (given, given)
            for given in map(new.get, ("lens", "response"))
        )
        size = np.asarray(new["size"])
        if size.shape not in ((2,), (2, 2)):
            raise ConfigurationError(
                "size: expected the image's width and height in whole pixels, for both eyes or for "
                f"each, got {new['size']!r:.80}"
            )
        size = np.broadcast_to(size, (2, 2))
        focal, principal, distortion, pose = (
            as_operand(f"cameras.{name}", new[name], *own) for name, own in STACKED.items() if own
        )
        matrix = camera_matrix(focal, principal)
        return Cameras(
            *(
                Camera(
                    size=size[eye],
                    matrix=matrix[..., eye, :, :],
                    lens=_trimmed(lens[eye], distortion[..., eye, :], name),
                    response=response[eye],
                    pose=pose[..., eye, :, :],
                )
                for eye, name in enumerate(EYE_NAMES)
            )
        )


STACKED: Final[dict[str, tuple[int | str, ...]]] = {
    "size": (), "focal": (2, 2), "principal": (2, 2), "lens": (), "distortion": (2, "n"),
    "response": (), "pose": (2, 4, 4),
}  # fmt: skip
"""Values of a pair of cameras; of those that may be a population's, the shape for one head."""


def _trimmed(model: Any, coefficients: FloatArray, eye: str) -> Lens:
    """Lens of coefficients that are padded with zeros or lack zeros at the end."""
    count = len(LENSES.get(model, ()))
    if coefficients[..., count:].any() and model in LENSES:
        raise ConfigurationError(
            f"distortion: expected {count} coefficients for the {eye} eye's {model} lens and zeros "
            f"beyond, got {coefficients.tolist()!r:.80}"
        )
    if 4 <= coefficients.shape[-1] < count:
        missing = np.zeros((*coefficients.shape[:-1], count - coefficients.shape[-1]))
        coefficients = np.concatenate([coefficients, missing], axis=-1)
    return Lens(model, coefficients[..., :count])


def _checked_lens(model: str, coefficients: ArrayLike) -> Lens:
    if model not in LENSES:
        raise ConfigurationError(f"lens: expected one of {', '.join(LENSES)}, got {model!r:.80}")
    values, count = np.asarray(coefficients, np.float64), len(LENSES[model])
    if not values.size:
        values = np.zeros(count)
    if values.shape[-1] != count:
        raise ConfigurationError(f"distortion: expected {count} numbers, got {values.shape[-1]}")
    if np.isnan(values).any():
        raise ConfigurationError(f"distortion: expected numbers, got {values.tolist()!r:.80}")
    return Lens(model, readonly_array(values))


def _whole_size(size: Any) -> tuple[int, int]:
    array = np.asarray(size)
    numbers = array.dtype.kind in "iuf" and array.shape == (2,)
    if not numbers or not ((array >= 1) & (array == np.floor(array)) & (array < 1e9)).all():
        raise ConfigurationError(
            f"size: expected the image's width and height in whole pixels, got {size!r:.80}"
        )
    return int(array[0]), int(array[1])


@kernel(["(f8[:],f8[:],f8[:])"], f"(2),({CAMERA_LENGTH})->(2)")
def rays_to_pixels(ray: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Pixels (u, v) of rays (X / Z, Y / Z) in one camera, nan beyond the lens model."""
    out[0], out[1] = ray_to_pixel(camera_at(row, 0), ray[0], ray[1])


@kernel(["(f8[:],f8[:],f8[:])"], f"(2),({CAMERA_LENGTH})->(2)")
def pixels_to_rays(pixel: FloatArray, row: FloatArray, out: FloatArray) -> None:
    """Rays (X / Z, Y / Z) of pixels (u, v) in one camera, nan if the lens has no inverse there."""
    camera = camera_at(row, 0)
    x, y = pinhole_ray(camera, pixel[0], pixel[1])
    if is_distorted(camera):
        x, y = undistort_ray(camera, x, y)
    out[0], out[1] = x, y

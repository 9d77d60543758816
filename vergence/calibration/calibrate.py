"""Calibration of one camera or a pair from photographs of a board: result, checks, and files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vergence.calibration.adjustment import (
    BundleSolution,
    CameraRig,
    camera_parameter_names,
    rms_length,
)
from vergence.calibration.cameras import (
    FOLDS,
    CameraFit,
    choose_lens,
    cross_validation_mean_squares,
    cross_validation_residuals,
    fit_camera,
    fit_camera_pair,
    fit_consistent_views,
    mistaken_corners_px,
)
from vergence.calibration.observations import BoardObservations, detect_board_corners
from vergence.calibration.uncertainty import (
    DepthSigma,
    depth_sigma_at,
    rig_covariance,
    right_camera_pose_covariance,
)
from vergence.errors import ConfigurationError
from vergence.models.camera import Camera, CameraResponse, Lens, camera_matrix
from vergence.models.lens import LENSES
from vergence.models.parts import EYE_NAMES, CalibrationRecord, FloatArray
from vergence.models.stereo_files import ReadCameras, document_of_pair
from vergence.models.toml_table import toml_text
from vergence.perception.locate import MM
from vergence.reporting.runs import package_versions
from vergence.vision.targets import PlanarTarget

_DETECTION_PROGRESS: Final = 0.5
"""Fraction of the progress done after detection in all images (chosen)."""
_MOST_FOCAL_SIGMA: Final = 0.1
"""Relative standard deviation of a focal length from which on a camera is refused (chosen)."""
_MOST_JOINT_RATIO: Final = 3.0
"""Largest ratio of a pair's joint residual to the residual of its cameras alone, if a focal length
changes by `_MOST_FOCAL_CHANGE` too: beyond it a camera must have moved (chosen)."""
_MOST_FOCAL_CHANGE: Final = 0.01
"""Relative change of a focal length from a camera alone to the pair, see `_MOST_JOINT_RATIO`
(chosen)."""


class DroppedView(NamedTuple):
    """A view that was left out, or one image of a pair whose other image was kept."""

    view: str
    """Its file name; the left one if both images of a pair were left out."""
    why: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Calibration of one camera or of a pair."""

    observations: BoardObservations
    single_fits: tuple[CameraFit, ...]
    """(c) fit of each camera alone."""
    fit: CameraFit
    """Fit of all cameras together; for one camera its own fit."""
    covariance: FloatArray
    """(p, p) covariance of the parameters of `CameraRig.packed`."""
    held_out_px: FloatArray
    """(c, v, n, 2) cross-validation residuals of the kept views: each by cameras that were
    calibrated without it."""
    lens: str
    """The lens model."""
    lens_errors: Mapping[str, float]
    """Cross-validation error of each lens model that was tried, in units of sigma: the geometric
    mean over the views of each camera alone of their root mean squares."""
    read_errors: tuple[str, ...]
    """Files that could not be read, a line each."""

    @property
    def rig(self) -> CameraRig:
        """The cameras."""
        return self.fit.solution.rig

    @cached_property
    def sigma(self) -> FloatArray:
        """(p) standard deviations of the parameters of `CameraRig.packed`."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def baseline_mm(self) -> tuple[float, float]:
        """Distance between the cameras and its standard deviation, mm."""
        between = self.rig.blocks[-2]
        shift = self.rig.translation
        length = float(np.linalg.norm(shift))
        spread = self.covariance[between, between][3:, 3:]
        return MM * length, MM * float(np.sqrt(shift @ spread @ shift)) / length

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras: left and right of a pair, camera for a single one."""
        return tuple(EYE_NAMES) if len(self.single_fits) > 1 else ("camera",)

    @property
    def camera_values(self) -> list[tuple[str, str, float, float]]:
        """Name of a camera, name of its parameter, value, and sigma, one by one."""
        rig = self.rig
        return [
            (camera, *each)
            for camera, lens, values, block in zip(
                self.camera_names, rig.lenses, rig.camera_parameters, rig.blocks, strict=False
            )
            for each in zip(
                camera_parameter_names(lens), values.tolist(), self.sigma[block].tolist(),
                strict=True,
            )
        ]  # fmt: skip

    def camera(self, camera: int) -> Camera:
        """One of the cameras, without a pose."""
        values = self.rig.camera_parameters[camera]
        return Camera(
            size=self.observations.image_sizes[camera],
            matrix=camera_matrix(values[:2], values[2:4]),
            lens=Lens(self.rig.lenses[camera], values[4:]),
        )

    @property
    def pair(self) -> ReadCameras:
        """The cameras of a pair."""
        right = np.eye(4)
        right[:3, :3] = self.rig.rotation.T
        right[:3, 3] = -self.rig.rotation.T @ self.rig.translation
        return ReadCameras(left=self.camera(0), right=replace(self.camera(1), pose=right))

    @property
    def noise_px(self) -> float:
        """A detected corner's standard deviation per coordinate, from each camera alone."""
        return float(np.sqrt(0.5 * np.mean(np.square(self.rms_alone_px))))

    def depth_sigma_at(self, distance_m: FloatArray) -> DepthSigma:
        """Uncertainty of depth along the bisector of the axes, (n) m from the baseline's middle."""
        return depth_sigma_at(
            self.fit.solution, self.covariance, self.observations.image_sizes, self.noise_px,
            distance_m,
        )  # fmt: skip

    @property
    def rms_alone_px(self) -> list[float]:
        """(c) root mean square residual of each camera alone."""
        return [rms_length(fit.solution.residuals_px) for fit in self.single_fits]

    @property
    def dropped(self) -> list[DroppedView]:
        """Views and images that were left out, and why."""
        found = []
        for view, kept in enumerate(self.fit.kept_views.tolist()):
            reasons = [self._reason(camera, view) for camera in range(len(self.single_fits))]
            if not kept:
                each = zip(EYE_NAMES, reasons, strict=False)
                why = "; ".join(f"{eye} image: {reason}" for eye, reason in each if reason)
                if reasons[0] and len(set(reasons)) == 1:
                    why = reasons[0]
                elif not why:
                    misfit = _misfit(self.fit.views, self.fit.kept_views, view)
                    why = f"both images together: {misfit}: did the board or a camera move?"
                found.append(DroppedView(Path(self.observations.file_names[0][view]).name, why))
                continue
            for camera, reason in enumerate(reasons):
                if reason:
                    other = EYE_NAMES[1 - camera]
                    name = Path(self.observations.file_names[camera][view]).name
                    found.append(DroppedView(name, f"{reason}; the {other} image went in"))
        return found

    def _reason(self, camera: int, view: int) -> str:
        """Explain why a photograph does not fit its own camera; empty if it does."""
        fit = self.single_fits[camera]
        why = self.observations.excluded.get(self.observations.file_names[camera][view])
        if why is not None:
            return why
        if not self.observations.usable[camera, view]:
            return "the board was not found"
        if fit.kept_views[view]:
            return ""
        return f"{_misfit(fit.views, fit.kept_views, view)}: blurred, or corners mistaken?"

    def document(self) -> dict[str, Any]:
        """The result as plain values."""
        dropped = [one._asdict() for one in self.dropped]
        common = {
            "rms_heldout_px": rms_length(self.held_out_px),
            "lens": self.lens,
            "views": int(self.fit.kept_views.sum()),
            "dropped": dropped,
        }
        if len(self.single_fits) == 1:
            return {"rms_px": self.rms_alone_px[0], **common}
        baseline, sigma = self.baseline_mm
        left, right = self.rms_alone_px
        return {
            "rms_left_px": left,
            "rms_right_px": right,
            "rms_stereo_px": rms_length(self.fit.solution.residuals_px),
            "rms_heldout_px": common.pop("rms_heldout_px"),
            "baseline_mm": baseline,
            "baseline_sigma_mm": sigma,
            **common,
        }


def _misfit(views: BundleSolution, kept: NDArray[np.bool_], view: int) -> str:
    usual = float(np.median(views.view_rms_px[kept]))
    return f"{views.view_rms_px[view]:.2f} px, where others leave {usual:.2f}"


def calibrate(
    target: PlanarTarget,
    photographs: Sequence[Sequence[Path]],
    lens: str | None = None,
    progress: Callable[[float], None] | None = None,
    response: CameraResponse | None = None,
) -> Calibration:
    """Calibrate one camera, or two that are fixed to each other.

    Args:
        target: the board.
        photographs: (c, v) the files of each camera, view by view.
        lens: the lens model, of `LENSES`; None for the one that predicts unseen views best.
        progress: called with the fraction done.
        response: light by grey level of every camera; None for the default of each image's format,
            see `default_response`.

    Raises:
        ConfigurationError: the photographs give no calibration; the message says why.
    """
    report = progress or (lambda fraction: None)
    seen, failures = detect_board_corners(
        target,
        photographs,
        lambda done: report(_DETECTION_PROGRESS * done),
        [response] * len(photographs),
    )
    found = calibrate_views(
        seen, lens, lambda done: report(_DETECTION_PROGRESS + (1.0 - _DETECTION_PROGRESS) * done)
    )
    return replace(found, read_errors=tuple(failures))


def calibrate_views(
    observations: BoardObservations,
    lens: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Calibrate from the detected corners of one camera or two, see `calibrate`."""
    report = progress or (lambda fraction: None)
    cameras = len(observations.file_names)
    lenses = tuple(LENSES) if lens is None else (lens,)
    ticks, done = 1 + 2 * cameras * len(lenses) + FOLDS, count(1)

    def tick() -> None:
        report(min(next(done) / ticks, 1.0))

    if not observations.target.size_known and cameras > 1:
        raise ConfigurationError(
            "target: expected the size of a square, which the baseline needs, "
            f"got {observations.target}"
        )
    observations = observations.without_alike_views()
    fits, errors = _fit_by_lens(observations, lenses, tick)
    chosen = choose_lens(errors)
    single_fits = tuple(fits[chosen])
    away_px = np.stack(
        [
            mistaken_corners_px(observations.problem.select_camera(camera), one.solution.rig)
            for camera, one in enumerate(single_fits)
        ]
    )
    if away_px.any():
        return calibrate_views(observations.without_corners(away_px), lens, progress)
    for camera, one in enumerate(single_fits):
        _refuse_unsure(one.solution, camera, cameras)
    try:
        fit = single_fits[0]
        if cameras > 1:
            observations, fit = fit_camera_pair(observations, *single_fits)
            _refuse_moved_cameras(fit, single_fits)
        found = Calibration(
            observations=observations,
            single_fits=single_fits,
            fit=fit,
            covariance=rig_covariance(fit.solution),
            held_out_px=cross_validation_residuals(fit.solution, tick),
            lens=chosen,
            lens_errors={
                each: float(np.exp(0.5 * np.mean(np.log(one)))) for each, one in errors.items()
            },
            read_errors=(),
        )
    except np.linalg.LinAlgError:
        raise ConfigurationError(
            "expected views that determine where the cameras are, got too few, or all alike"
        ) from None
    report(1.0)
    return found


def _fit_by_lens(
    observations: BoardObservations, lenses: Sequence[str], tick: Callable[[], None]
) -> tuple[dict[str, list[CameraFit]], dict[str, FloatArray]]:
    """Each camera's fit alone by lens model that fits at all, and the errors of all their views.

    Errors are `cross_validation_mean_squares`, of the views that at least one lens fits.
    """
    every = [observations.select_camera(k) for k in range(len(observations.file_names))]
    firsts = []
    for camera, one in enumerate(every):
        try:
            firsts.append(fit_consistent_views(one))
        except np.linalg.LinAlgError:
            raise _unsure(camera, len(every), "none at all") from None
    tick()
    fits: dict[str, list[CameraFit]] = {}
    errors: dict[str, FloatArray] = {}
    refused: ConfigurationError | None = None
    for lens in lenses:
        found, squares = [], []
        try:
            for one, first in zip(every, firsts, strict=True):
                found.append(fit_camera(one, lens, first))
                tick()
                squares.append(cross_validation_mean_squares(found[-1], one.problem))
                tick()
            fits[lens], errors[lens] = found, np.concatenate(squares)
        except np.linalg.LinAlgError:
            refused = _unsure(0, len(every), "none at all")
        except ConfigurationError as error:
            refused = error
    if refused is not None and not fits:
        raise refused
    kept = [np.concatenate([fit.kept_views for fit in each]) for each in fits.values()]
    return fits, {lens: each[np.any(kept, axis=0)] for lens, each in errors.items()}


def _refuse_unsure(solution: BundleSolution, camera: int, cameras: int) -> None:
    """Refuse a camera whose focal length the views do not determine."""
    values = solution.rig.camera_parameters[0]
    sigma = np.sqrt(np.diagonal(rig_covariance(solution)))[:2]
    if not float((sigma / values[:2]).max()) < _MOST_FOCAL_SIGMA:
        known = "none at all"
        if sigma.max() < values[:2].max():
            known = f"{values[0]:.0f} px with a deviation of {sigma.max():.0f} px"
        raise _unsure(camera, cameras, known)


def _refuse_moved_cameras(fit: CameraFit, single_fits: Sequence[CameraFit]) -> None:
    """Refuse pairs of images that two cameras fixed to each other cannot have taken."""
    together = float(np.median(fit.views.view_rms_px[fit.kept_views]))
    apart = float(
        np.median([np.median(one.views.view_rms_px[one.kept_views]) for one in single_fits])
    )
    changes = [
        float(np.abs(values[:2] / one.solution.rig.camera_parameters[0][:2] - 1.0).max())
        for values, one in zip(fit.solution.rig.camera_parameters, single_fits, strict=True)
    ]
    if together > _MOST_JOINT_RATIO * apart and max(changes) > _MOST_FOCAL_CHANGE:
        raise ConfigurationError(
            "expected two cameras that are fixed to each other, got pairs of images that leave "
            f"{together:.2f} px together where each leaves {apart:.2f} px by itself, and a focal "
            f"length {100.0 * max(changes):.1f} % off: did a camera move between the pairs?"
        )


def _unsure(camera: int, cameras: int, known: str) -> ConfigurationError:
    whose = f"the {EYE_NAMES[camera]} camera's" if cameras > 1 else "the camera's"
    return ConfigurationError(
        f"expected views that determine {whose} focal length, got some that determine {known}: "
        "tilt the "
        "board by some 30 degrees, each time another way, and fill the image with it"
    )


_RECORDED_PACKAGES: Final = ("vergence", "opencv-python-headless", "numpy", "scipy")
_ROS_LENSES: Final[dict[str, str]] = {
    "brown-conrady": "plumb_bob",
    "rational": "rational_polynomial",
    "fisheye": "equidistant",
}


def head_file_text(
    calibration: Calibration, name: str, response: CameraResponse | None = None
) -> str:
    """Write the head file of a calibrated pair as TOML text."""
    document = document_of_pair(
        calibration.pair,
        name,
        noise_px=calibration.noise_px,
        calibration=calibration_record(calibration),
        response=response,
    )
    return toml_text(document)


def calibration_record(calibration: Calibration) -> CalibrationRecord:
    """Record the origin and uncertainty of a calibrated pair."""
    sigma = {
        f"{eye}.camera.{name}": deviation for eye, name, _, deviation in calibration.camera_values
    }
    between = calibration.rig.blocks[-2]
    placed = right_camera_pose_covariance(calibration.rig, calibration.covariance[between, between])
    names = ("rx", "ry", "rz", "x", "y", "z")
    deviations = np.sqrt(np.diagonal(placed)).tolist()
    sigma |= {f"right.head_eye.{n}": d for n, d in zip(names, deviations, strict=True)}
    return CalibrationRecord(
        target=str(calibration.observations.target),
        views=int(calibration.fit.kept_views.sum()),
        rms_px=rms_length(calibration.fit.solution.residuals_px),
        rms_heldout_px=rms_length(calibration.held_out_px),
        corners_sha256=calibration.observations.digest,
        versions=", ".join(
            f"{name} {each}" for name, each in package_versions(_RECORDED_PACKAGES).items()
        ),
        sigma=sigma,
    )


def ros_camera_document(calibration: Calibration) -> dict[str, Any]:
    """Convert a camera's calibration to plain values with the keys of ROS's camera_info files."""
    camera = calibration.camera(0)
    lens, coefficients = camera.lens
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_model": _ROS_LENSES[lens],
        "distortion_coefficients": {
            "rows": 1,
            "cols": len(coefficients),
            "data": np.asarray(coefficients).tolist(),
        },
        "calibration": {
            "target": str(calibration.observations.target),
            "views": int(calibration.fit.kept_views.sum()),
            "rms_px": calibration.rms_alone_px[0],
            "rms_heldout_px": rms_length(calibration.held_out_px),
            "corners_sha256": calibration.observations.digest,
            "versions": package_versions(_RECORDED_PACKAGES),
            "sigma": {name: sigma for _, name, _, sigma in calibration.camera_values},
        },
    }

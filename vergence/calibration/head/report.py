"""Run folder of a calibrated head: head file, tables and HTML report."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from vergence.calibration.adjustment import rms_length
from vergence.calibration.head import figures
from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.calibration.head.depth import DepthErrors, points_ahead, predict_depth_errors
from vergence.calibration.head.observability import UnobservableDirection
from vergence.calibration.head.start import LEAST_CORNERS
from vergence.files import write_atomic
from vergence.models.parts import EYE_NAMES
from vergence.operands import null_nonfinite_elements, null_nonfinite_rows
from vergence.reporting.report import inline_svg
from vergence.reporting.runs import package_versions, write_json
from vergence.reporting.style import svg_text
from vergence.reporting.text import (
    format_fixed,
    format_number,
    jinja_environment,
    read_template,
)

DEPTHS_M: Final = (0.3, 0.5, 1.0, 2.0, 2.5, 3.0)
"""Distances of the table of depth, m (chosen: the range of use)."""
_SUMMARY_DISTANCES_M: Final = (0.5, 1.0, 2.5)
"""Distances of the summary at the top of the report, m (chosen)."""
_MAP_DISTANCES_M: Final = (1.0, 2.5)
"""Distances of the maps of depth errors, m (chosen)."""
_UNIT_FORMATS: Final[dict[str, tuple[float, str, int]]] = {
    "rad": (180.0 / np.pi, "°", 4),
    "m": (1e3, "mm", 3),
    "px": (1.0, "px", 2),
    "1": (1.0, "", 5),
}
"""Format of each unit in the table of parameters: factor, name, and digits."""


_MOST_ROWS: Final = 40
"""Most rows of the table of views left out (chosen: a page's worth; the rest is in views.csv)."""


class LeftOutView(NamedTuple):
    """A view that was left out."""

    time_s: float
    eye: str
    why: str


def write_run(
    folder: Path,
    calibration: HeadCalibration,
    unobservable: Sequence[UnobservableDirection],
    head_file_text: str,
    head_file_name: str,
    provenance: Mapping[str, str],
) -> None:
    """Write a calibration's head file, its tables and its report."""
    (folder / head_file_name).write_text(head_file_text, encoding="utf-8")
    names, units, before = calibration.nominal_head.parameters()
    own = calibration.solution.problem
    scatter_ratio = np.ones(7) if own.scatter_ratio is None else own.scatter_ratio
    write_json(
        folder / "result.json",
        {
            **result_document(calibration, unobservable),
            "left_out_views": [one._asdict() for one in left_out_views(calibration)],
            "recording": dict(provenance),
            "noisier": {
                each: float(times)
                for each, times in zip(
                    figures.actuator_names(calibration), scatter_ratio, strict=True
                )
                if each
            },
            "names": list(names),
            "units": list(units),
            "before": before.tolist(),
            "after": calibration.solution.state.head_parameters.tolist(),
            "sigma": calibration.sigma.tolist(),
            "believed_sigma": own.prior_sigma.tolist(),
            "covariance": calibration.covariance.tolist(),
            "versions": package_versions(),
        },
    )
    _write_views(folder / "views.csv", calibration)
    write_report(folder, calibration, unobservable, head_file_name, provenance)


def result_document(
    calibration: HeadCalibration, unobservable: Sequence[UnobservableDirection]
) -> dict[str, Any]:
    """Convert the result to plain values for JSON."""
    depth = predict_depth_errors(calibration, points_ahead(np.array(DEPTHS_M)))
    table = {
        "distance_m": depth.distance_m,
        "before_mm": 1e3 * depth.nominal_error_m,
        "before_vector_mm": 1e3 * depth.nominal_error_norm_m,
        "before_percent": depth.nominal_error_percent,
        "after_sigma_mm": 1e3 * depth.sigma_m,
        "after_percent": depth.sigma_percent,
        "floor_mm": 1e3 * depth.noise_floor_m,
    }
    rows = zip(*(null_nonfinite_elements(values) for values in table.values()), strict=True)
    views = calibration.frames.seen.any(axis=-1)
    return {
        "depth": [dict(zip(table, row, strict=True)) for row in rows],
        "noise": calibration.solution.reduced_chi,
        "rms_px": rms_length(figures.residuals_px(calibration)),
        "rms_heldout_sigma": null_nonfinite_rows(_heldout(calibration)),
        "views": int(calibration.kept_views.sum()),
        "left_out": int((views & ~calibration.kept_views).sum()),
        "frames": len(calibration.frames.time_s),
        "poses": int(calibration.frames.pose.max()) + 1,
        "placements": int(calibration.frames.placement.max()) + 1,
        "target": str(calibration.frames.target),
        "terms": [each._asdict() for each in calibration.terms],
        "unseen": [
            {"what": each.what, "cure": each.remedy, "cost": each.cost} for each in unobservable
        ],
        "remarks": list(calibration.remarks),
    }


def _heldout(calibration: HeadCalibration) -> float:
    """Root mean square cross-validation error in units of sigma; nan without any view."""
    known = np.isfinite(calibration.held_out_mean_squares)
    return (
        float(np.sqrt(np.mean(calibration.held_out_mean_squares[known])))
        if known.any()
        else float("nan")
    )


def left_out_views(calibration: HeadCalibration) -> list[LeftOutView]:
    """List the views that show corners and were left out, in the order of time."""
    frames, residuals = calibration.frames, figures.normalised_view_rms(calibration)
    usual = float(np.median(residuals[calibration.kept_views]))
    count = frames.seen.sum(axis=-1)

    def why(eye: int, frame: int) -> str:
        left = float(residuals[eye, frame])
        if count[eye, frame] < LEAST_CORNERS:
            return f"{count[eye, frame]} corners, where {LEAST_CORNERS} are needed"
        if np.isinf(left):
            return "its board belongs behind the camera"
        if left > usual:
            return f"{left:.3g} times sigma, where others leave {usual:.2g}"
        return "an angle that was read wrong"

    lost = np.argwhere((count > 0).T & ~calibration.kept_views.T)
    return [
        LeftOutView(float(frames.time_s[frame]), EYE_NAMES[eye], why(eye, frame))
        for frame, eye in lost.tolist()
    ]


def _write_views(path: Path, calibration: HeadCalibration) -> None:
    """Write a row for each frame and eye; missing numbers are empty."""
    frames = calibration.frames
    residuals = calibration.solution.normal.residuals * frames.sigma
    counted = figures.kept_or_found_corners(calibration)
    held_out = np.sqrt(calibration.held_out_mean_squares)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["time_s", "pose", "placement", "eye", "kept", "corners", "rms_px", "rms_heldout_sigma"]
        )
        for frame, eye in np.ndindex(len(frames.time_s), 2):
            mine = counted[eye, frame]
            squares = (residuals[eye, frame][mine] ** 2).sum(axis=-1)
            left = float(np.sqrt(squares.mean())) if len(squares) else np.nan
            numbers = (left, float(held_out[eye, frame]))
            table.writerow(
                [
                    repr(float(frames.time_s[frame])),
                    int(frames.pose[frame]),
                    int(frames.placement[frame]),
                    EYE_NAMES[eye],
                    bool(calibration.kept_views[eye, frame]),
                    int(mine.sum()),
                    *(repr(each) if np.isfinite(each) else "" for each in numbers),
                ]
            )


def write_report(
    folder: Path,
    calibration: HeadCalibration,
    unobservable: Sequence[UnobservableDirection],
    head_file_name: str,
    provenance: Mapping[str, str],
) -> None:
    """Write calibration.html, which is self-contained."""
    drawn = _figures(calibration).items()
    depth = predict_depth_errors(calibration, points_ahead(np.array(_SUMMARY_DISTANCES_M)))
    page = jinja_environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.calibration.head", "head.html.jinja"))
    text = template.render(
        **result_document(calibration, unobservable),
        head=calibration.nominal_head.name,
        name=head_file_name,
        provenance=provenance,
        headline=_headline(depth),
        eyes=EYE_NAMES,
        maps=[f"{each:g}" for each in _MAP_DISTANCES_M],
        dropped=[
            [f"{one.time_s:.2f} s, {one.eye}", one.why]
            for one in left_out_views(calibration)[:_MOST_ROWS]
        ],
        numbers=_number_rows(calibration),
        markup={stem: inline_svg(svg_text(figure), stem, stem) for stem, figure in drawn},
        style=read_template("vergence.reporting", "page.css"),
        versions=package_versions(),
    )
    write_atomic(folder / "calibration.html", text)


def _headline(depth: DepthErrors) -> list[tuple[str, str, str]]:
    """Format distance, error before, and deviation after, for distances that the eyes reach."""
    return [
        (f"{distance:g}", format_number(abs(before)), format_number(after))
        for distance, before, after in zip(
            depth.distance_m.tolist(), (1e3 * depth.nominal_error_m).tolist(),
            (1e3 * depth.sigma_m).tolist(), strict=True,
        )
        if np.isfinite(before) and np.isfinite(after)
    ]  # fmt: skip


def _figures(calibration: HeadCalibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    drawn = {"depth": figures.depth_error_by_distance(calibration)}
    for distance in _MAP_DISTANCES_M:
        drawn[f"map-{distance:g}"] = figures.depth_error_maps(calibration, distance)
    drawn["views"] = figures.residuals_over_time(calibration)
    for eye, name in enumerate(EYE_NAMES):
        drawn[f"residuals-{name}"] = figures.residual_field(calibration, eye)
        drawn[f"coverage-{name}"] = figures.corner_coverage(calibration, eye)
    drawn["joints"] = figures.joint_angle_coverage(calibration)
    if figures.determined_reading_errors(calibration):
        drawn["readings"] = figures.reading_error_histograms(calibration)
    if len(figures.correlated_parameters(calibration)):
        drawn["correlations"] = figures.parameter_correlations(calibration)
    return drawn


def _number_rows(calibration: HeadCalibration) -> list[list[str]]:
    """Format the rows of the table of head parameters."""
    own, rows = calibration.solution.problem, []
    for name, unit, before, after, sigma, spread in zip(
        *calibration.nominal_head.parameters()[:2], own.prior_mean.tolist(),
        calibration.solution.state.head_parameters.tolist(), calibration.sigma.tolist(),
        own.prior_sigma.tolist(), strict=True,
    ):  # fmt: skip
        scale, said, digits = _UNIT_FORMATS[unit]
        free = spread > 0.0
        rows.append(
            [
                f"{name} ({said})" if said else name,
                format_fixed(scale * before, digits),
                format_fixed(scale * after, digits),
                format_fixed(scale * sigma if free else None, digits),
                format_fixed((after - before) / spread if free else None, 2, signed=True),
            ]
        )
    return rows

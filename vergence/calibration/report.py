"""Run folder of a calibration: camera file, tables and HTML report."""

import csv
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from vergence.calibration import figures
from vergence.calibration.adjustment import rms_length
from vergence.calibration.calibrate import Calibration
from vergence.calibration.coverage import (
    advise_next_photographs,
    board_sag,
    board_tilts,
    camera_names,
    median_and_corner_sigma_px,
)
from vergence.calibration.depth import depth_sigma_at, depths_to_plot_m, pixel_noise_px
from vergence.calibration.projection import camera_parameter_names
from vergence.files import write_atomic
from vergence.models.parts import EYE_NAMES
from vergence.reporting.report import inline_svg
from vergence.reporting.runs import package_versions, write_json
from vergence.reporting.style import svg_text
from vergence.reporting.text import (
    format_fixed,
    format_number,
    jinja_environment,
    read_template,
)

_DEPTHS_M: Final = (0.5, 1.0, 2.0, 2.5)
"""Distances of the table of depth, m (chosen: the range of use)."""


def write_run(folder: Path, calibration: Calibration, file_text: str, file_name: str) -> None:
    """Write a calibration's file, its tables and its report."""
    (folder / file_name).write_text(file_text, encoding="utf-8")
    names = calibration.rig.names(EYE_NAMES[: len(calibration.single_fits)])
    write_json(
        folder / "result.json",
        {
            **calibration.document(),
            "advice": advise_next_photographs(calibration),
            "lens_errors": dict(calibration.lens_errors),
            "numbers": dict(zip(names, calibration.rig.packed().tolist(), strict=True)),
            "sigma": dict(zip(names, calibration.sigma.tolist(), strict=True)),
            "covariance": calibration.covariance.tolist(),
        },
    )
    with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["view", "kept", "rms_px", "noise"])
        for view, path in enumerate(calibration.observations.file_names[0]):
            views = calibration.fit.views
            table.writerow(
                [
                    Path(path).name,
                    bool(calibration.fit.kept_views[view]),
                    views.rms_px[view],
                    views.reduced_chi[view],
                ]
            )
    write_report(folder, calibration, file_name)


def write_report(folder: Path, calibration: Calibration, file_name: str) -> None:
    """Write calibration.html, which is self-contained."""
    drawn = _figures(calibration).items()
    markup = {stem: inline_svg(svg_text(figure), stem, stem) for stem, figure in drawn}
    page = jinja_environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.calibration", "calibration.html.jinja"))
    text = template.render(
        **_values(calibration),
        name=file_name,
        markup=markup,
        style=read_template("vergence.reporting", "page.css"),
        versions=package_versions(),
    )
    write_atomic(folder / "calibration.html", text)


def _figures(calibration: Calibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    drawn = {}
    for camera, name in enumerate(camera_names(calibration)):
        drawn[f"residuals-{name}"] = figures.residual_field(calibration, camera)
        drawn[f"radius-{name}"] = figures.residuals_by_radius(calibration, camera)
        drawn[f"coverage-{name}"] = figures.image_coverage(calibration, camera)
        drawn[f"directions-{name}"] = figures.direction_sigma(calibration, camera)
    drawn["tilts"] = figures.tilt_directions(calibration)
    drawn["distances"] = figures.tilts_by_distance(calibration)
    drawn["views"] = figures.view_residuals(calibration)
    if len(calibration.single_fits) > 1:
        depth = depth_sigma_at(calibration, depths_to_plot_m(calibration))
        drawn["depth"] = figures.depth_sigma(depth, in_percent=False)
        drawn["depth-relative"] = figures.depth_sigma(depth, in_percent=True)
    return drawn


def _values(calibration: Calibration) -> dict[str, Any]:
    """Collect the values for the template."""
    names = camera_names(calibration)
    several = len(names) > 1
    held = board_tilts(calibration, 0)
    return {
        "several": several,
        "names": names,
        "target": str(calibration.observations.target),
        "lens": calibration.lens,
        "sizes": calibration.observations.image_sizes,
        "kept": int(calibration.fit.kept_views.sum()),
        "every": len(calibration.fit.kept_views),
        "dropped": calibration.dropped,
        "alone_px": calibration.rms_alone_px,
        "together_px": rms_length(calibration.fit.solution.residuals_px),
        "held_out_px": rms_length(calibration.held_out_px),
        "baseline": calibration.baseline_mm if several else None,
        "focal": [
            (float(values[0]), float(calibration.sigma[block][0]))
            for values, block in zip(
                calibration.rig.camera_parameters, calibration.rig.blocks, strict=False
            )
        ],
        "lenses": dict(calibration.lens_errors),
        "sag": board_sag(calibration),
        "advice": advise_next_photographs(calibration),
        "remarks": calibration.read_errors,
        "tilt_deg": np.quantile(held.angle_deg, [0.0, 0.5, 1.0]).tolist(),
        "distance_m": [float(held.distance_m.min()), float(held.distance_m.max())],
        "directions": [
            median_and_corner_sigma_px(calibration, camera) for camera in range(len(names))
        ],
        "depths": _depth_rows(calibration) if several else [],
        "noise_px": pixel_noise_px(calibration),
        "numbers": _number_rows(calibration),
    }


def _depth_rows(calibration: Calibration) -> list[list[str]]:
    """Format the rows of the depth table."""
    depth = depth_sigma_at(calibration, np.array(_DEPTHS_M))
    columns = (
        1e3 * depth.calibration_m,
        1e3 * depth.noise_m,
        1e3 * depth.total_m,
        1e2 * depth.total_m / depth.distance_m,
    )
    return [
        [f"{distance:g} m", *(format_number(float(column[row])) for column in columns)]
        for row, distance in enumerate(_DEPTHS_M)
    ]


def _number_rows(calibration: Calibration) -> list[list[str]]:
    """Format the rows of the table of camera parameters."""
    rows = []
    for name, lens, values, block in zip(
        camera_names(calibration),
        calibration.rig.lenses,
        calibration.rig.camera_parameters,
        calibration.rig.blocks,
        strict=False,
    ):
        for label, value, sigma in zip(
            camera_parameter_names(lens),
            values.tolist(),
            calibration.sigma[block].tolist(),
            strict=True,
        ):
            digits = 2 if label[1] == "_" else 5
            rows.append(
                [f"{name} {label}", format_fixed(value, digits), format_fixed(sigma, digits)]
            )
    return rows

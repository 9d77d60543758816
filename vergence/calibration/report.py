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
    board_tilts,
    board_sag,
    camera_names,
    median_and_corner_sigma_px,
)
from vergence.calibration.depth import depth_sigma_at, depths_to_plot_m, pixel_noise_px
from vergence.calibration.projection import camera_parameter_names
from vergence.eval.reporting.report import inline_svg
from vergence.eval.reporting.runs import versions, write_json
from vergence.eval.reporting.style import svg_of
from vergence.eval.reporting.text import environment, format_fixed, format_number, read_template
from vergence.files import write_atomic
from vergence.models.joints import EYE_NAMES

_DEPTHS_M: Final = (0.5, 1.0, 2.0, 2.5)
"""Distances of the table of depth, m (chosen: the range of use)."""


def write_run(folder: Path, found: Calibration, content: str, name: str) -> None:
    """Write a calibration's file, its tables and its report.

    Args:
        folder: the run folder.
        found: the calibration.
        content: content of the calibration's file.
        name: name of that file.
    """
    (folder / name).write_text(content, encoding="utf-8")
    names = found.rig.names(EYE_NAMES[: len(found.single_fits)])
    write_json(
        folder / "result.json",
        {
            **found.document(),
            "advice": advise_next_photographs(found),
            "lens_errors": dict(found.lens_errors),
            "numbers": dict(zip(names, found.rig.packed().tolist(), strict=True)),
            "sigma": dict(zip(names, found.sigma.tolist(), strict=True)),
            "covariance": found.covariance.tolist(),
        },
    )
    with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["view", "kept", "rms_px", "noise"])
        for view, path in enumerate(found.seen.names[0]):
            views = found.fit.views
            table.writerow(
                [
                    Path(path).name,
                    bool(found.fit.kept[view]),
                    views.rms_px[view],
                    views.reduced_chi[view],
                ]
            )
    write_report(folder, found, name)


def write_report(folder: Path, found: Calibration, name: str) -> None:
    """Write calibration.html, which is self-contained.

    Args:
        folder: the run folder.
        found: the calibration.
        name: name of the calibration's file.
    """
    drawn = _figures(found).items()
    markup = {stem: inline_svg(svg_of(figure), stem, stem) for stem, figure in drawn}
    page = environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = page.from_string(read_template("vergence.calibration", "calibration.html.jinja"))
    text = template.render(
        **_values(found),
        name=name,
        markup=markup,
        style=read_template("vergence.eval.reporting", "page.css"),
        versions=versions(),
    )
    write_atomic(folder / "calibration.html", text)


def _figures(found: Calibration) -> dict[str, Figure]:
    """Draw all figures, by name."""
    drawn = {}
    for camera, name in enumerate(camera_names(found)):
        drawn[f"residuals-{name}"] = figures.residual_field(found, camera)
        drawn[f"radius-{name}"] = figures.residuals_by_radius(found, camera)
        drawn[f"coverage-{name}"] = figures.image_coverage(found, camera)
        drawn[f"directions-{name}"] = figures.direction_sigma(found, camera)
    drawn["tilts"] = figures.tilt_directions(found)
    drawn["distances"] = figures.tilts_by_distance(found)
    drawn["views"] = figures.view_residuals(found)
    if len(found.single_fits) > 1:
        depth = depth_sigma_at(found, depths_to_plot_m(found))
        drawn["depth"] = figures.depth_sigma(depth, relative=False)
        drawn["depth-relative"] = figures.depth_sigma(depth, relative=True)
    return drawn


def _values(found: Calibration) -> dict[str, Any]:
    """Collect the values for the template."""
    names = camera_names(found)
    several = len(names) > 1
    held = board_tilts(found, 0)
    return {
        "several": several,
        "names": names,
        "target": str(found.seen.target),
        "lens": found.lens,
        "sizes": found.seen.sizes,
        "kept": int(found.fit.kept.sum()),
        "every": len(found.fit.kept),
        "dropped": found.dropped,
        "alone_px": found.rms_alone_px,
        "together_px": rms_length(found.fit.solution.residuals_px),
        "held_out_px": rms_length(found.held_out_px),
        "baseline": found.baseline_mm if several else None,
        "focal": [
            (float(values[0]), float(found.sigma[block][0]))
            for values, block in zip(found.rig.values, found.rig.blocks, strict=False)
        ],
        "lenses": dict(found.lens_errors),
        "sag": board_sag(found),
        "advice": advise_next_photographs(found),
        "remarks": found.failures,
        "tilt_deg": np.quantile(held.angle_deg, [0.0, 0.5, 1.0]).tolist(),
        "distance_m": [float(held.distance_m.min()), float(held.distance_m.max())],
        "directions": [median_and_corner_sigma_px(found, camera) for camera in range(len(names))],
        "depths": _depth_rows(found) if several else [],
        "noise_px": pixel_noise_px(found),
        "numbers": _number_rows(found),
    }


def _depth_rows(found: Calibration) -> list[list[str]]:
    """Format the rows of the depth table."""
    depth = depth_sigma_at(found, np.array(_DEPTHS_M))
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


def _number_rows(found: Calibration) -> list[list[str]]:
    """Format the rows of the table of camera parameters."""
    rows = []
    for name, lens, values, block in zip(
        camera_names(found), found.rig.lenses, found.rig.values, found.rig.blocks, strict=False
    ):
        for label, value, sigma in zip(
            camera_parameter_names(lens), values.tolist(), found.sigma[block].tolist(), strict=True
        ):
            digits = 2 if label[1] == "_" else 5
            rows.append(
                [f"{name} {label}", format_fixed(value, digits), format_fixed(sigma, digits)]
            )
    return rows

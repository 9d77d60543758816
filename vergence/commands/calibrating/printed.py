"""Printed results of `vergence calibrate` for one camera or a pair."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from vergence.commands.tables import print_table

if TYPE_CHECKING:
    from vergence.calibration.calibrate import Calibration


def print_calibration(calibration: "Calibration", out: Path) -> None:
    """Print a calibration: values, residuals, views left out, and the path of its file."""
    from vergence.calibration.adjustment import rms_length
    from vergence.calibration.projection import camera_parameter_names
    from vergence.models.joints import EYE_NAMES

    several = len(calibration.single_fits) > 1
    names = list(EYE_NAMES) if several else ["camera"]
    rows = []
    for camera, (name, values) in enumerate(
        zip(names, calibration.rig.camera_parameters, strict=False)
    ):
        sigma = calibration.sigma[calibration.rig.blocks[camera]]
        for label, value, deviation in zip(
            camera_parameter_names(calibration.lens), values.tolist(), sigma.tolist(), strict=True
        ):
            digits = 2 if label[1] == "_" else 5
            rows.append([name, label, f"{value:.{digits}f}", f"{deviation:.{digits}f}"])
    if several:
        baseline, deviation = calibration.baseline_mm
        digits = max(2, 1 - math.floor(math.log10(max(deviation, 1e-9))))
        rows.append(["pair", "baseline (mm)", f"{baseline:.{digits}f}", f"{deviation:.{digits}f}"])
    print_table(
        ["of", "number", "value", "sigma"],
        rows,
        title=f"cameras ({calibration.lens})",
        wrapped=(0, 1),
    )
    rows = [
        [f"{name} by itself", f"{each:.3f}"]
        for name, each in zip(names, calibration.rms_alone_px, strict=True)
    ]
    if several:
        rows.append(["both together", f"{rms_length(calibration.fit.solution.residuals_px):.3f}"])
    rows.append(["views held out", f"{rms_length(calibration.held_out_px):.3f}"])
    kept, every = int(calibration.fit.kept_views.sum()), len(calibration.fit.kept_views)
    print_table(["residual", "rms (px)"], rows, title=f"{kept} of {every} views", wrapped=(0,))
    if calibration.dropped:
        print_table(
            ["left out", "why"],
            [list(one) for one in calibration.dropped],
            wrapped=(0, 1),
            shortenable=(0,),
        )
    if several:
        larger = f"if it is 1 % larger, the baseline is {1.01 * calibration.baseline_mm[0]:.2f} mm"
        print(f"lengths are as right as the board ({calibration.observations.target}): {larger}\n")
    print(out)

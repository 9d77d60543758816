"""The run folder of a calibration."""

import csv
from pathlib import Path

from vergence.calibration.calibrate import Calibration
from vergence.eval.reporting.runs import write_json
from vergence.models.joints import EYE_NAMES


def write_run(folder: Path, found: Calibration, content: str, name: str) -> None:
    """Write a calibration's tables and its report.

    Args:
        folder: where to.
        found: the calibration.
        content: of the file that it makes.
        name: of that file.
    """
    (folder / name).write_text(content, encoding="utf-8")
    names = found.rig.names(EYE_NAMES[: len(found.alone)])
    write_json(
        folder / "result.json",
        {
            **found.document(),
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
                [Path(path).name, bool(found.fit.kept[view]), views.rms_px[view], views.noise[view]]
            )

"""The run folder of a head's calibration."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from vergence.calibration.head.calibrate_head import HeadCalibration
from vergence.calibration.head.depth import ahead, depth_errors
from vergence.calibration.head.observability import Unseen
from vergence.eval.reporting.runs import write_json
from vergence.plain import plain

_DISTANCES_M: Final = (0.5, 1.0, 2.5)


def document(found: HeadCalibration, unseen: Sequence[Unseen]) -> dict[str, Any]:
    """The result as plain values."""
    depth = depth_errors(found, ahead(np.array(_DISTANCES_M)))
    return {
        "depth": [
            {
                "distance_m": distance,
                "before_mm": plain(1e3 * depth.before_m[row]),
                "after_sigma_mm": plain(1e3 * depth.sigma_m[row]),
                "floor_mm": plain(1e3 * depth.floor_m[row]),
            }
            for row, distance in enumerate(_DISTANCES_M)
        ],
        "noise": found.solution.noise,
        "rms_px": found.rms_px,
        "views": int(found.views.sum()),
        "left_out": int((found.frames.seen.any(axis=-1) & ~found.views).sum()),
        "poses": len(np.unique(found.frames.pose)),
        "placements": len(np.unique(found.frames.placement)),
        "unseen": [one._asdict() for one in unseen],
    }


def write_run(
    folder: Path,
    found: HeadCalibration,
    unseen: Sequence[Unseen],
    content: str,
    name: str,
    recording: Mapping[str, str],
) -> None:
    """Write a calibration's tables."""
    (folder / name).write_text(content, encoding="utf-8")
    write_json(folder / "result.json", {**document(found, unseen), "recording": dict(recording)})

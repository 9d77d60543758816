"""Printed description of one head, for `vergence info --head`."""

import json
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final

from vergence.commands.console import print_to_stderr
from vergence.commands.head_tables import (
    print_assumptions,
    print_calibration_record,
    print_cameras,
    print_joints,
    warn_of_lens_folds,
    warn_of_zero_outside_range,
)
from vergence.commands.tables import print_table

if TYPE_CHECKING:
    from vergence.eval.head_summary import HeadSummary

_FIXATED_PX: Final = 1.0
"""Largest residual pixel error at which eyes count as fixating, px (chosen: the settling band)."""


def print_head_description(source: str, *, as_json: bool, figure: Path | None) -> None:
    """Print the parts of a head, its reach and its depth errors."""
    from vergence.commands.assumed import assumed_values
    from vergence.eval.head_summary import summarise_head
    from vergence.models.head_file import load_head

    head = load_head(source)
    summary = summarise_head(head)
    if figure is not None:  # before the tables: a closed pipe on standard output ends the program
        from vergence.eval.head_figure import draw_head

        draw_head(head, figure, summary)
    if as_json:
        print(json.dumps(summary.json_document(), indent=2))
    else:
        _print_tables(summary)
        print_assumptions(assumed_values(head))
    warn_of_zero_outside_range(summary.joints)
    warn_of_lens_folds(summary.eyes)
    if figure is not None:
        print_to_stderr(f"{figure} is written")


def _print_tables(summary: "HeadSummary") -> None:
    from vergence.controllers.controller import WHICH_LAW

    rows = [
        ["digest", summary.digest[:12]],
        ["baseline", f"{summary.baseline_mm:.2f} mm at rest"],
        [
            "loop",
            f"{summary.control_rate_hz:g} Hz, {summary.frame_rate_hz:g} images a second, "
            f"{summary.latency_ms:.1f} ms old",
        ],
        *([["law", WHICH_LAW]] if summary.has_moving_eyes else []),
        *_reach(summary),
        *_depth_errors(summary),
    ]
    print_table(["number", "value"], rows, title=f"head {summary.name}", wrapped=(0, 1))
    print_joints("joints", summary.joints)
    print_joints("actuators of the eyes", summary.actuators)
    if not summary.has_moving_eyes:
        print("The eyes do not move: points are found by triangulate_views alone.\n")
    print_cameras(summary.eyes)
    if summary.calibration is not None:
        print_calibration_record(summary.calibration)


def _reach(summary: "HeadSummary") -> list[list[str]]:
    from vergence.eval.head_reach import NEAREST_M

    reach = summary.reach
    exact = summary.has_moving_eyes and summary.least_error_px < _FIXATED_PX
    what = "both eyes fixate" if exact else "both eyes see"
    if not isfinite(reach.nearest_m):
        return [[what, "no point straight ahead"]]
    nearest = f"{reach.nearest_m:.3g} m{' or less' if reach.nearest_m <= NEAREST_M else ''}"
    farthest = f"{reach.farthest_m:.3g} m" if isfinite(reach.farthest_m) else "any distance"
    sides = [
        f"{angle:.0f} deg {side}" if isfinite(angle) else f"nothing {side}"
        for angle, side in (
            (reach.left_deg, "left"),
            (reach.right_deg, "right"),
            (reach.up_deg, "up"),
            (reach.down_deg, "down"),
        )
    ]
    return [
        [f"{what} straight ahead", f"from {nearest} to {farthest}"],
        [f"{what} at {reach.distance_m:.3g} m", ", ".join(sides)],
    ]


def _depth_errors(summary: "HeadSummary") -> list[list[str]]:
    from vergence.eval.head_summary import LEAST_RESIDUAL_PX

    rows = [
        [
            f"depth error at {depth} m",
            f"{error:.3g} mm" if isfinite(error) else "out of reach",
        ]
        for depth, error in summary.depth_error_mm.items()
    ]
    noise = f"{summary.detection_noise_px:g} px of detection noise"
    if summary.has_moving_eyes:
        finest, coarsest = (f"{step:.3g}" for step in summary.encoder_steps_deg)
        steps = f"steps of {finest} to" if finest != coarsest else "a step of"
        noise += f", encoders with {steps} {coarsest} deg"
        if summary.backlash_deg > 0.0:
            noise += f", and a play of up to {summary.backlash_deg:.3g} deg"
    rows.append(
        ["", f"one standard deviation of one fix, from {noise}; no error of calibration is in it"]
    )
    if summary.least_error_px >= LEAST_RESIDUAL_PX:
        most, why = f"up to {summary.least_error_px:.3g} px", _fixation_limit(summary)
        rows.append(["least pixel error", f"{most} at these depths and sides: {why}"])
    return rows


def _fixation_limit(summary: "HeadSummary") -> str:
    """Reason why the eyes of this head cannot both fixate a point exactly."""
    own = {
        eye.name: sum(joint.moves in (f"{eye.name} eye", "both eyes") for joint in summary.joints)
        for eye in summary.eyes
    }
    lacking = [name for name, count in own.items() if count < 2]
    if len(lacking) == 2:
        return "each eye turns about one axis at most"
    if lacking:
        axes = "one axis only" if own[lacking[0]] else "no axis"
        return f"the {lacking[0]} eye turns about {axes}"
    return "the eyes are tied"

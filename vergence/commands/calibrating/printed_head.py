"""Printed results of `vergence calibrate head`."""

from pathlib import Path
from typing import TYPE_CHECKING

from vergence.commands.tables import print_table

if TYPE_CHECKING:
    from vergence.calibration.head.job import HeadOutcome


def print_head_calibration(outcome: "HeadOutcome", out: Path) -> None:
    """Print a head's calibration and the path of its file."""
    told = outcome.document
    rows = [
        [
            f"{each['distance_m']:g} m",
            *(_fixed(each[key]) for key in ("before_mm", "after_sigma_mm", "floor_mm")),
        ]
        for each in told["depth"]
    ]
    print_table(
        ["distance", "file is off by (mm)", "sigma now (mm)", "one fixation's sigma (mm)"],
        rows, title="depth straight ahead", wrapped=(0,),
    )  # fmt: skip
    print(
        f"{told['views']} of {told['views'] + told['left_out']} views in {told['poses']} poses, "
        f"{told['placements']} placement{'s' if told['placements'] > 1 else ''} of the board; "
        f"{told['rms_px']:.3f} px (length, rms) are left, {told['noise']:.2f} times what the "
        "detector says\n"
    )
    if outcome.unobservable:
        print_table(
            ["not determined by this recording", "cure", "cost"],
            [[one.what, one.remedy or "none needed", one.cost] for one in outcome.unobservable],
            wrapped=(0, 1, 2), shortenable=(0, 1, 2),
        )  # fmt: skip
    print(out)


def print_head_calibrations(outcomes: "list[HeadOutcome]", outs: list[Path]) -> None:
    """Print a line for each of several heads."""
    rows = []
    for outcome, out in zip(outcomes, outs, strict=True):
        if outcome.refusal:
            rows.append([str(out), "refused", "", "", ""])
            continue
        told = outcome.document
        last = told["depth"][-1]
        views = f"{told['views']} of {told['views'] + told['left_out']}"
        rows.append(
            [str(out), views, f"{told['rms_px']:.3f}", _fixed(last["before_mm"]),
             _fixed(last["after_sigma_mm"])]
        )  # fmt: skip
    far = next(
        (f"{one.document['depth'][-1]['distance_m']:g} m" for one in outcomes if one.document), ""
    )
    print_table(
        ["head", "views", "rms (px)", f"file off at {far} (mm)", "sigma now (mm)"],
        rows, wrapped=(0, 1), shortenable=(0,),
    )  # fmt: skip


def _fixed(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"

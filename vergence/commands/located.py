"""Printed results of `vergence locate`: points, standard deviations, measured edge lengths."""

from typing import Final

import numpy as np

from vergence.commands.tables import print_table
from vergence.perception.finding import tag_number
from vergence.perception.locate import MM, LocatedTarget, LocateResult, measure_spacing
from vergence.reporting.text import NONE, format_fixed
from vergence.vision.targets import AprilTag


def print_located_targets(result: LocateResult) -> None:
    """Print a table for each board, and one for all tags of one family and size."""
    for every in result.located_by_target():
        of_tags = tag_number(every[0].target) is not None
        head = ["pair", "tag" if of_tags else "found"]
        head += ["x (mm)", "y (mm)", "z (mm)", "centre sigma (mm)", "gap (mm)", "edge (mm)"]
        rows = [_row(one) for one in every]
        if not of_tags:
            head.append("spread (mm)")
            rows = [
                [*row, format_fixed(MM * one.spacing.spread_m, 2)]
                for row, one in zip(rows, every, strict=True)
            ]
        target = every[0].target
        title = f"tags of {target.family}" if isinstance(target, AprilTag) else str(target)
        print_table(head, rows, title=title, shortenable=(0,))
        print()
        poses = [_pose_row(one) for one in every]
        print_table([*head[:2], "rotation (deg)", "sigma (deg)"], poses, shortenable=(0,))
        print(_together(result, every))
        for mark, text in _POSE_MARKS.items():
            if any(mark in row[2] for row in poses):
                print(f"{mark} {text}")
        print()


_POSE_MARKS: Final = {
    "!": "no pose explains the corners of both images",
    "?": "two tilts fit the corners: the other is in targets.csv and the JSON",
}
"""Marks of rotations and what they mean."""


def _pose_row(located: LocatedTarget) -> list[str]:
    """Rotation vector from N to T and its sigma about x, y and z of N, degrees."""
    pose, row = located.pose, _row(located)[:2]
    if pose is None:
        return [*row, NONE, NONE]
    turned, sigma = np.degrees(pose.rotation_vector), np.degrees(pose.sigma[3:])
    mark = "!" if pose.contradicted else "" if pose.other is None else "?"
    return [
        *row,
        " ".join(f"{value:7.2f}" for value in turned) + mark,
        " ".join(f"{value:6.3f}" for value in sigma),
    ]


def _together(result: LocateResult, every: list[LocatedTarget]) -> str:
    """Summary line on targets of one kind in all pairs."""
    target = every[0].target
    edges = measure_spacing(target, [one.fix.point for one in every])
    found = f"{len({one.pair for one in every if one.valid.any()})} of {len(result.angles)} pairs"
    if not edges.edge_count:
        return found
    of_tags = tag_number(target) is not None
    text = (
        f"{found}; {'edges of tags' if of_tags else 'neighbouring corners'} "
        f"{format_fixed(MM * edges.mean_m, 3)} mm in the mean, "
        f"spread {format_fixed(MM * edges.spread_m, 3)} mm"
    )
    if np.isfinite(edges.stated_m):
        off = format_fixed(100.0 * (edges.mean_m / edges.stated_m - 1.0), 2, signed=True)
        text += f"; stated {MM * edges.stated_m:g} mm ({off} %)"
    return text


def _row(located: LocatedTarget) -> list[str]:
    number, edges = tag_number(located.target), located.spacing
    what = f"{int(located.valid.sum())}/{len(located.valid)}"
    return [
        located.pair,
        what if number is None else str(number),
        *(format_fixed(MM * value, 2) for value in located.centre.point),
        " ".join(format_fixed(MM * value, 2) for value in located.centre.sigma),
        format_fixed(MM * located.gap_m, 2),
        format_fixed(MM * edges.mean_m, 2) + ("!" if edges.differs_from_stated else ""),
    ]

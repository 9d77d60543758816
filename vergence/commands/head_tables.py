"""Tables of a head's parts, shared by the commands that print them."""

from collections.abc import Sequence
from math import degrees
from typing import TYPE_CHECKING, Final

from vergence.commands.console import print_to_stderr
from vergence.commands.tables import print_table

if TYPE_CHECKING:
    from vergence.commands.assumed import AssumedValue
    from vergence.eval.head_summary import EyeSummary, JointSummary
    from vergence.models.parts import CalibrationRecord

_SIGMAS: Final = (
    ("left focal length", "left.camera", ("f_u", "f_v"), 1.0, "px"),
    ("left principal point", "left.camera", ("u_0", "v_0"), 1.0, "px"),
    ("right focal length", "right.camera", ("f_u", "f_v"), 1.0, "px"),
    ("right principal point", "right.camera", ("u_0", "v_0"), 1.0, "px"),
    ("right position", "right.head_eye", ("x", "y", "z"), 1000.0, "mm along x, y, z"),
    ("right rotation", "right.head_eye", ("rx", "ry", "rz"), degrees(1.0), "deg about x, y, z"),
)
"""Standard deviations of a calibration that are printed: name, part, keys, scale, unit."""


def print_joints(title: str, joints: "Sequence[JointSummary]") -> None:
    """Print joints or actuators: the eyes they move, their range, their limits."""
    if not joints:
        return
    rows = [
        [
            joint.name,
            joint.moves,
            f"{joint.lower_deg:.1f} to {joint.upper_deg:.1f}",
            f"{joint.velocity_deg_s:.0f}",
            f"{joint.acceleration_rad_s2:g}",
        ]
        for joint in joints
    ]
    columns = ["name", "moves", "range deg", "deg/s", "rad/s^2"]
    print_table(columns, rows, title=title, wrapped=(0, 1))


def print_cameras(eyes: "Sequence[EyeSummary]") -> None:
    """Print the cameras of the eyes: image sizes, intrinsics, fields of view, lens models."""
    rows = [
        [
            eye.name,
            f"{eye.width_px} x {eye.height_px}",
            f"{eye.focal_px[0]:.1f}, {eye.focal_px[1]:.1f}",
            f"{eye.principal_px[0]:.1f}, {eye.principal_px[1]:.1f}",
            f"{eye.horizontal_deg:.1f} x {eye.vertical_deg:.1f}",
            eye.lens,
        ]
        for eye in eyes
    ]
    columns = ["eye", "image px", "focal px", "principal px", "view deg", "lens"]
    print_table(columns, rows, title="cameras", wrapped=(0, 5))


def print_calibration_record(record: "CalibrationRecord") -> None:
    """Print how a head was calibrated, and the standard deviations except those of the lens."""
    rows = [
        ["board", f"{record.target}, {record.views} views"],
        ["rms", f"{record.rms_px:.3f} px, of views held out {record.rms_heldout_px:.3f} px"],
    ]
    for name, part, values, scale, unit in _SIGMAS:
        keys = [f"{part}.{value}" for value in values]
        if part == "right.head_eye" and "left.head_eye.x" in record.sigma:
            continue  # a head that moves: the values of single eyes are not observable
        if all(key in record.sigma for key in keys):
            told = ", ".join(f"{scale * record.sigma[key]:.3g}" for key in keys)
            rows.append([f"sigma, {name}", f"{told} {unit}"])
    rows.append(["versions", record.versions])
    print_table(["number", "value"], rows, title="calibration", wrapped=(0, 1))


def warn_of_lens_folds(eyes: "Sequence[EyeSummary]") -> None:
    """Warn of images with parts that no ray reaches, because the lens model folds back there."""
    for eye in eyes:
        if eye.folds:
            print_to_stderr(
                f"warning: the lens model of the {eye.name} eye has no rays in a part of its image "
                f"of {eye.width_px} x {eye.height_px} px, where it folds back on itself or looks "
                f"90 degrees or more aside: none beyond {eye.horizontal_deg:.0f} x "
                f"{eye.vertical_deg:.0f} degrees"
            )


def print_assumptions(assumptions: "Sequence[AssumedValue]") -> None:
    """Print the values that are assumed, not measured: keys, values and reasons."""
    rows = [[", ".join(keys), value, why] for keys, value, why in assumptions]
    if rows:
        columns = ["assumed, not measured", "value", "why"]
        print_table(columns, rows, title="assumptions", wrapped=(0, 1, 2))


def warn_of_zero_outside_range(joints: "Sequence[JointSummary]") -> None:
    """Warn of joints whose range excludes zero, the angle of rest."""
    for joint in joints:
        if joint.lower_deg > 0.0 or joint.upper_deg < 0.0:
            print_to_stderr(
                f"warning: the range of {joint.name}, {joint.lower_deg:.1f} to "
                f"{joint.upper_deg:.1f} degrees, is without zero, where the head was measured: "
                "at rest it is at the nearest angle that it has (is a sign or an offset wrong?)"
            )

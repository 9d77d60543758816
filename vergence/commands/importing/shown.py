"""What `vergence import urdf` prints: what was read, what was assumed, what was left out."""

from collections.abc import Mapping

import numpy as np

from vergence.commands.tables import print_table
from vergence.models.files.import_urdf import ImportedHead
from vergence.models.joint_axes import JointAxes


def show_import(imported: ImportedHead) -> None:
    """Print what became of a robot's description."""
    head, chains = imported.head, imported.chains
    assert isinstance(head.links, JointAxes)  # what the file's form is read as
    rows = []
    for name, places in zip(head.links.names, head.links.places, strict=True):
        place = places[0]
        low, high = np.rad2deg([head.limits.lower[place], head.limits.upper[place]])
        rows.append(
            [
                name,
                chains.parts[name],
                f"{low:.1f} to {high:.1f}",
                f"{head.limits.velocity[place]:.3g}",
                f"{head.limits.acceleration[place]:.3g}",
            ]
        )
    columns = ["joint", "moves", "range, degrees", "rad/s", "rad/s^2"]
    print_table(columns, rows, title=f"joints of {head.name}", text=(0, 1))
    if imported.motors:
        rows = []
        for motor in imported.motors:
            moves = ", ".join(f"{factor:g} {joint}" for joint, factor in motor.joints.items())
            low, high = np.rad2deg([motor.range.lower, motor.range.upper])
            rows.append([motor.name, moves, f"{low:.1f} to {high:.1f}"])
        print_table(["motor", "moves", "range, degrees"], rows, title="motors", text=(0, 1))
    if chains.fixed:
        held = [[name, f"{value:.6g}"] for name, value in chains.fixed.items()]
        print_table(["held joint", "at, rad or m"], held, text=(0,))
    _show_assumptions(head.assumptions)
    print(f"left out: {'; '.join(imported.ignored)}")


def _show_assumptions(assumptions: Mapping[str, str]) -> None:
    """What is assumed, by the reason, which many values may share."""
    by_reason: dict[str, list[str]] = {}
    for key, why in assumptions.items():
        by_reason.setdefault(why, []).append(key)
    rows = [[", ".join(keys), why] for why, keys in by_reason.items()]
    if rows:
        print_table(["assumed", "why"], rows, title="assumptions", text=(0, 1))

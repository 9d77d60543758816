"""Read and write the actuators of the eye joints as TOML, and derive the joint limits from them.

Each `[[actuators]]` table gives the ratio of joint angle to actuator angle for every joint that it
moves, such as `joints = { left_pan = 0.5, right_pan = -0.5 }`. Without these tables each joint has
an actuator of its own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vergence.errors import HeadFileError
from vergence.models.actuation import Actuators
from vergence.models.files.head_rules import (
    ACTUATOR_OWN,
    JOINT_LIMITS,
    LIMIT_FIELDS,
    RADIANS,
    RATIO,
)
from vergence.models.files.joints_toml import refuse_empty_range
from vergence.models.files.toml_table import Table
from vergence.models.joint_axes import JointAxes
from vergence.models.joints import EYES, JOINTS
from vergence.models.parts import FloatArray, JointLimits


def parse_actuators(root: Table, links: JointAxes) -> Actuators | None:
    """Read the actuators of a head file; None if each joint has its own."""
    if not root.has("actuators"):
        return None
    tables = root.tables("actuators")
    if not 1 <= len(tables) <= 4:
        raise HeadFileError("actuators", f"{len(tables)} tables", "1 to 4 tables [[actuators]]")
    eyes = links.joints[EYES]
    names: list[str] = []
    matrix, offset = np.zeros((4, len(tables))), np.zeros(4)
    columns: dict[str, list[float]] = {field: [] for field in (*JOINT_LIMITS, *ACTUATOR_OWN)}
    for k, table in enumerate(tables):
        name = table.text("name", "an actuator's name")
        if name in names:
            raise HeadFileError(table.key("name"), name, "a name that no other actuator has")
        names.append(name)
        moves = table.table("joints")
        for joint in moves.names():
            places = [i for i, own in enumerate(eyes) if own == joint]
            if not places:
                known = ", ".join(dict.fromkeys(filter(None, eyes)))
                raise HeadFileError(moves.key(joint), joint, f"a joint of the eyes: {known}")
            matrix[places, k] = moves.number(joint, RATIO)
        for field, rule in JOINT_LIMITS.items():
            columns[field].append(table.number(field, rule))
        refuse_empty_range(name, np.array([columns["lower_rad"][-1], columns["upper_rad"][-1]]))
        for field, rule in ACTUATOR_OWN.items():
            given = table.number(field, rule) if table.has(field) else np.nan
            columns[field].append(0.0 if field == "backlash_rad" and np.isnan(given) else given)
        table.close()
    if root.has("joint_offsets_rad"):
        offsets = root.table("joint_offsets_rad")
        for joint in offsets.names():
            places = [i for i, own in enumerate(eyes) if own == joint]
            if not places:
                raise HeadFileError(offsets.key(joint), None, "a joint of the eyes")
            offset[places] = offsets.number(joint, RADIANS)
    still = sorted({own for own, row in zip(eyes, matrix, strict=True) if own and not row.any()})
    if still:
        raise HeadFileError(
            "actuators",
            f"none that moves {', '.join(still)}",
            "an actuator for each joint of the eyes (or no [[actuators]]: then each has its own)",
        )
    if np.linalg.matrix_rank(matrix) < len(tables):
        raise HeadFileError(
            "actuators", matrix.tolist(), "actuators none of which does what others can do"
        )
    return Actuators(
        names=tuple(names),
        matrix=matrix,
        offset=offset,
        lower=np.array(columns["lower_rad"]),
        upper=np.array(columns["upper_rad"]),
        velocity=np.array(columns["velocity_rad_s"]),
        acceleration=np.array(columns["acceleration_rad_s2"]),
        **{field: np.array(columns[field]) for field in ACTUATOR_OWN},
    )


def joint_limits(
    links: JointAxes, limits_in_file: Sequence[FloatArray | None], actuators: Actuators | None
) -> JointLimits:
    """Limits of the seven joints: those in the file, or else the range that the actuators reach."""
    seven = np.zeros((4, len(JOINTS)))
    seven[3] = np.inf
    for name, places, own in zip(links.names, links.joint_indices, limits_in_file, strict=True):
        if own is not None:
            seven[:, places] = own[:, None]
            continue
        if actuators is None or places[0] < EYES.start:
            raise HeadFileError(
                f"joints {name}", None, f"{', '.join(JOINT_LIMITS)} (the keys are missing)"
            )
        row = actuators.matrix[places[0] - EYES.start]
        centre = actuators.offset[places[0] - EYES.start]
        ends = np.stack([row * actuators.lower, row * actuators.upper])
        seven[0, places] = centre + ends.min(axis=0).sum()
        seven[1, places] = centre + ends.max(axis=0).sum()
        seven[2, places] = np.abs(row) @ actuators.velocity
        used = row != 0.0
        seven[3, places] = np.abs(row[used]) @ actuators.acceleration[used]
    return JointLimits(lower=seven[0], upper=seven[1], velocity=seven[2], acceleration=seven[3])


def actuators_to_toml(links: JointAxes, actuators: Actuators) -> dict[str, Any]:
    """Write the tables of actuators; `parse_actuators` reads exactly the same values back."""
    eyes = links.joints[EYES]
    tables: dict[str, Any] = {
        "actuators": [
            {
                "name": name,
                "joints": {
                    joint: float(factor)
                    for joint, factor in zip(eyes, actuators.matrix[:, k], strict=True)
                    if factor != 0.0
                },
                **{key: float(getattr(actuators, own)[k]) for key, own in LIMIT_FIELDS.items()},
                **{
                    field: float(getattr(actuators, field)[k])
                    for field in ACTUATOR_OWN
                    if np.isfinite(getattr(actuators, field)[k])
                },
            }
            for k, name in enumerate(actuators.names)
        ]
    }
    if actuators.offset.any():
        tables["joint_offsets_rad"] = {
            joint: float(offset)
            for joint, offset in zip(eyes, actuators.offset, strict=True)
            if joint
        }
    return tables

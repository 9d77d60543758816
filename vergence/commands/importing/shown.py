"""What `vergence import` prints: what was read, what was assumed, what was left out."""

from vergence.commands.head_tables import (
    print_assumptions,
    print_cameras,
    print_joints,
    warn_of_folds,
    warn_of_rest,
)
from vergence.commands.tables import print_table
from vergence.eval.head_summary import (
    actuator_summaries,
    baseline_mm,
    eye_summaries,
    joint_summaries,
)
from vergence.models.files.assumed_values import assumed_values
from vergence.models.files.import_urdf import ImportedHead
from vergence.models.head import HeadModel


def show_import(imported: ImportedHead) -> None:
    """Print what became of a robot's description."""
    head, chains = imported.head, imported.chains
    print_joints(f"joints of {head.name}", joint_summaries(head))
    warn_of_rest(joint_summaries(head))
    print_joints("actuators of the eyes", actuator_summaries(head))
    if chains.fixed:
        held = [[name, f"{value:.6g}"] for name, value in chains.fixed.items()]
        print_table(["held joint", "at, rad or m"], held, text=(0,))
    show_eyes(head)
    print(f"left out: {'; '.join(imported.ignored)}")


def show_eyes(head: HeadModel) -> None:
    """Print what became of cameras, and what was assumed."""
    eyes = eye_summaries(head)
    print_cameras(eyes)
    print(f"baseline {baseline_mm(head):.2f} mm at rest\n")
    warn_of_folds(eyes)
    print_assumptions(assumed_values(head))

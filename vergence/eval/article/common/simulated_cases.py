"""The simulated rig under different model errors: the controller's model and the true head.

To add a case, such as a calibrated model, add an entry to `CASES`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians
from typing import Final, NamedTuple

from vergence.eval.article.experiment import job_rng
from vergence.models.head import HeadModel
from vergence.models.head_file import load_head
from vergence.models.perturbation import ModelErrors

_DRAW: Final = "simulated-rig"


class NominalAndTrueHead(NamedTuple):
    """The controller's model of a head, and the true head."""

    nominal: HeadModel
    true: HeadModel


DRAWN_ERRORS: Final = ModelErrors(
    link_m=5e-5,
    coaxiality_rad=radians(0.02),
    joint_offset_rad=radians(0.02),
    head_eye_rad=radians(0.02),
    head_eye_m=1e-4,
    focal_relative=5e-4,
    principal_px=0.3,
)
"""Standard deviations of the model errors drawn for the simulated rig."""


@dataclass(frozen=True, kw_only=True)
class RigCase:
    """One set of model errors."""

    title: str
    """Short title for figures."""
    make: Callable[[HeadModel, ModelErrors, int], NominalAndTrueHead]
    """Function from (the preset, the errors' standard deviations, the run's seed) to the rig."""


def draw_true_heads(preset: HeadModel, errors: ModelErrors, seed: int, count: int) -> HeadModel:
    """Draw true heads with model errors, to see how representative a single draw is.

    Args:
        preset: the model.
        errors: standard deviations of the model errors.
        seed: the run's seed.
        count: number of heads.

    Returns:
        A population of shape (count,), independent of the head of the case `drawn`.
    """
    return preset.perturbed(job_rng(seed, _DRAW, 1), errors, count)


def with_true_principal_points(preset: HeadModel) -> HeadModel:
    """The preset with its principal points at the true image centres.

    With pixel centres at integers these are ((W - 1) / 2, (H - 1) / 2); Table 2 says
    ((W + 1) / 2, (H + 1) / 2).
    """
    return preset.replace(cameras={"principal": (preset.cameras.size - 1) / 2.0})


def _exact(preset: HeadModel, errors: ModelErrors, seed: int) -> NominalAndTrueHead:
    return NominalAndTrueHead(preset, preset)


def _principal(preset: HeadModel, errors: ModelErrors, seed: int) -> NominalAndTrueHead:
    return NominalAndTrueHead(preset, with_true_principal_points(preset))


def _drawn(preset: HeadModel, errors: ModelErrors, seed: int) -> NominalAndTrueHead:
    return NominalAndTrueHead(preset, preset.perturbed(job_rng(seed, _DRAW, 0), errors))


CASES: Final[dict[str, RigCase]] = {
    "exact": RigCase(title="exact model", make=_exact),
    "principal": RigCase(title="principal point 1 px off", make=_principal),
    "drawn": RigCase(title="drawn model errors", make=_drawn),
}
"""The cases by name, in the order of the figures."""


def make_nominal_and_true_head(case: str, errors: ModelErrors, seed: int) -> NominalAndTrueHead:
    """Make the simulated rig under a case's model errors.

    Args:
        case: one of `CASES`.
        errors: standard deviations of the drawn model errors.
        seed: the run's seed.
    """
    return CASES[case].make(load_head("simulated"), errors, seed)

"""The simulated rig under different errors of its model: what the controller knows, what is true.

Another case, such as a calibrated model, is one more entry of `CASES`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians
from typing import Final, NamedTuple

from vergence.eval.article.experiment import job_rng
from vergence.models.files.head_file import load_head
from vergence.models.head import HeadModel
from vergence.models.perturbation import ModelErrors

_DRAW: Final = "simulated-rig"


class Rig(NamedTuple):
    """A head as the controller knows it, and as it is."""

    known: HeadModel
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
"""How large the errors are that are drawn for the simulated rig."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One set of model errors."""

    title: str
    """A few words for figures."""
    make: Callable[[HeadModel, ModelErrors, int], Rig]
    """(the preset, the errors' sizes, the run's seed) to the rig."""


def drawn_population(preset: HeadModel, errors: ModelErrors, seed: int, count: int) -> HeadModel:
    """True heads with model errors as drawn, to see how far one draw speaks for others.

    Args:
        preset: the model.
        errors: how large the errors are.
        seed: the run's seed.
        count: how many heads.

    Returns:
        A population of shape (count,); the head of the case `drawn` is another draw.
    """
    return preset.perturbed(job_rng(seed, _DRAW, 1), errors, count)


def true_principal(preset: HeadModel) -> HeadModel:
    """The head whose principal points are the images' true centres.

    With pixel centres at integers that is ((W - 1) / 2, (H - 1) / 2); Table 2 says
    ((W + 1) / 2, (H + 1) / 2).
    """
    return preset.replace(cameras={"principal": (preset.cameras.size - 1) / 2.0})


def _exact(preset: HeadModel, errors: ModelErrors, seed: int) -> Rig:
    return Rig(preset, preset)


def _principal(preset: HeadModel, errors: ModelErrors, seed: int) -> Rig:
    return Rig(preset, true_principal(preset))


def _drawn(preset: HeadModel, errors: ModelErrors, seed: int) -> Rig:
    return Rig(preset, preset.perturbed(job_rng(seed, _DRAW, 0), errors))


CASES: Final[dict[str, Case]] = {
    "exact": Case(title="exact model", make=_exact),
    "principal": Case(title="principal point 1 px off", make=_principal),
    "drawn": Case(title="drawn model errors", make=_drawn),
}
"""The cases by name, in the order they are shown."""


def make_rig(case: str, errors: ModelErrors, seed: int) -> Rig:
    """The simulated preset under a case's model errors.

    Args:
        case: one of `CASES`.
        errors: how large drawn errors are.
        seed: the run's seed.
    """
    return CASES[case].make(load_head("simulated"), errors, seed)

"""A population of true heads that stands for the article's one head, of which little is known."""

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.eval.article.common.joint_offsets import with_joint_offsets
from vergence.eval.article.experiment import job_rng
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head import HeadModel
from vergence.models.joints import LINKS
from vergence.models.parts import FloatArray
from vergence.models.perturbation import ModelErrors

_LOWERS: Final = {"left_tilt": 1.0, "right_tilt": -1.0}
"""A positive left tilt looks down, a positive right tilt up."""


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The physical twin: how the true heads differ from the nominal one, and what they see with."""

    head: str = "physical"
    """One of the article's, simulated or physical: the nominal head, which controls."""
    heads: int = 100
    """How many true heads are drawn."""
    errors: ModelErrors = TWIN_SPREADS
    """Standard deviations of the true heads from the nominal one, before scaling."""
    largest_error_percent: float = 4.97
    """Largest depth error by gaze of the article's head over the static points, percent of
    depth: the population's median, by the one scalar that multiplies all errors."""
    scale: float = 0.0
    """That scalar; 0 to find it."""
    noise_poses: int = 4
    """Fixations of each static point on which the detector's noise is measured on images."""
    noise_frames: int = 40
    """Images of each."""


def draw_heads(nominal: HeadModel, errors: ModelErrors, count: int, seed: int) -> HeadModel:
    """The population of true heads; the same draws whatever the size of the errors.

    Args:
        nominal: the head that they deviate from.
        errors: by how much.
        count: how many.
        seed: the run's seed.

    Returns:
        A head of batch shape (count,).

    Raises:
        ConfigurationError: there are none.
    """
    if count < 1:
        raise ConfigurationError(f"heads: expected at least 1, got {count}")
    rng = job_rng(seed, "physical twin")
    # the common tilts are drawn first, so the rest of the head is the same with and without them
    tilt = errors.common_tilt_rad * rng.standard_normal(count)
    heads = nominal.perturbed(rng, dataclasses.replace(errors, common_tilt_rad=0.0), count)
    return with_common_tilt(heads, tilt)


def with_common_tilt(heads: HeadModel, tilt_rad: FloatArray) -> HeadModel:
    """Heads whose eyes both look lower than their encoders say.

    Args:
        heads: of batch shape (n,).
        tilt_rad: (n,) by how much, rad.

    Returns:
        The heads with other offsets of both tilts.
    """
    lowers = np.array([_LOWERS.get(joint, 0.0) for _frame, _parent, joint in LINKS])
    return with_joint_offsets(heads, lowers * np.asarray(tilt_rad)[:, None])

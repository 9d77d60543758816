"""A population of true heads in place of the article's single head, whose errors are not known."""

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from vergence.errors import ConfigurationError
from vergence.eval.article.common.joint_offsets import with_joint_offsets
from vergence.eval.article.experiment import job_rng
from vergence.eval.trials.twin_errors import TWIN_SPREADS
from vergence.models.head import HeadModel
from vergence.models.parts import LINKS, FloatArray
from vergence.models.perturbation import ModelErrors

_LOWERS: Final = {"left_tilt": 1.0, "right_tilt": -1.0}
"""Sign of the tilt that lowers an eye: positive left tilt looks down, positive right tilt up."""


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The physical twin: errors of the true heads against the nominal one, and their detector."""

    head: str = "physical"
    """The nominal head, used for control: one of the article's, simulated or physical."""
    heads: int = 100
    """Number of true heads drawn."""
    errors: ModelErrors = TWIN_SPREADS
    """Standard deviations of the true heads' model errors, before scaling."""
    largest_error_percent: float = 4.97
    """Largest depth error by gaze of the article's head over the static points, percent of depth.
    The scale is set so that the population's median is equal to it."""
    scale: float = 0.0
    """Factor on all standard deviations; 0 to find it from `largest_error_percent`."""
    noise_poses: int = 4
    """Fixations of each static point at which the detector's errors are measured on images."""
    noise_frames: int = 40
    """Images per fixation."""


def draw_heads(nominal: HeadModel, errors: ModelErrors, count: int, seed: int) -> HeadModel:
    """Draw the population of true heads; the random numbers do not depend on the errors' size.

    Args:
        nominal: the head that they deviate from.
        errors: standard deviations of the model errors.
        count: number of heads.
        seed: the run's seed.

    Returns:
        A head of batch shape (count,).

    Raises:
        ConfigurationError: count is below 1.
    """
    if count < 1:
        raise ConfigurationError(f"heads: expected at least 1, got {count}")
    rng = job_rng(seed, "physical twin")
    # common tilts are drawn first, so that all other errors are the same with and without them
    tilt = errors.common_tilt_rad * rng.standard_normal(count)
    heads = nominal.perturbed(rng, dataclasses.replace(errors, common_tilt_rad=0.0), count)
    return with_common_tilt(heads, tilt)


def with_common_tilt(heads: HeadModel, tilt_rad: FloatArray) -> HeadModel:
    """Lower both eyes of each head by an angle that the encoders do not measure.

    Args:
        heads: heads of batch shape (n,).
        tilt_rad: (n,) the angles, rad.

    Returns:
        The heads with changed offsets of both tilts.
    """
    lowers = np.array([_LOWERS.get(joint, 0.0) for _frame, _parent, joint in LINKS])
    return with_joint_offsets(heads, lowers * np.asarray(tilt_rad)[:, None])

"""Covariance of a head's parameters, robust to errors that are correlated within a pose.

The errors of the frames of a pose are correlated if the board is not as modelled or a joint gives
way. Therefore the groups of measurements are poses, as they are views in
`vergence.calibration.uncertainty`.
"""

import numpy as np

from vergence.calibration.head.adjust import CURVATURE_COUNT
from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.uncertainty import clustered_covariance
from vergence.models.parts import FloatArray


def head_and_term_covariance(solution: HeadSolution) -> FloatArray:
    """(p + t, p + t) covariance of `HeadModel.parameters`, then of the reading-error terms."""
    problem = solution.problem
    normal = problem.linearised(solution.state, solution.weights, keep_frame_parts=True)
    assert normal.frame_contributions is not None
    blocks, slopes = normal.frame_contributions
    p = len(problem.prior_mean)
    term_indices = np.arange(p + CURVATURE_COUNT, problem.common_count)
    kept = np.concatenate([np.arange(p), term_indices])
    rest = np.setdiff1d(np.arange(problem.shared_count), kept)
    # eliminate the boards and the errors of resting joints
    reduced = np.zeros((problem.shared_count + 1, len(kept)))
    reduced[kept] = np.eye(len(kept))
    reduced[rest] = -np.linalg.solve(
        normal.matrix[np.ix_(rest, rest)], normal.matrix[np.ix_(rest, kept)]
    )
    known = np.append(problem.prior_information, 0.0)
    poses, pose = np.unique(problem.frames.pose, return_inverse=True)
    information = np.zeros((len(poses), len(kept), len(kept)))
    gradients = np.zeros((len(poses), len(kept)))
    for frame, number in enumerate(pose):
        own = reduced[problem.frame_columns[frame]]
        information[number] += own.T @ blocks[frame] @ own
        gradients[number] += slopes[frame] @ own
    prior = reduced.T @ (known[:, None] * reduced)
    return clustered_covariance(information, gradients, max(solution.reduced_chi, 1.0), prior)

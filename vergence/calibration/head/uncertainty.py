"""How surely a head's numbers are known: by what each pose has to say of them.

The errors of the frames of a pose go together, where the board is not as it is believed to be or a
joint gives way, so poses are what is counted, as views are in `vergence.calibration.uncertainty`.
"""

import numpy as np

from vergence.calibration.head.adjust import BEND
from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.uncertainty import clustered_covariance
from vergence.models.parts import FloatArray


def head_covariance(solution: HeadSolution) -> FloatArray:
    """(p + t, p + t) covariance of the numbers of `HeadModel.parameters`, then the readings' rules.

    Args:
        solution: the head and how it was found.
    """
    problem = solution.problem
    normal = problem.linearised(solution.state, solution.weights, by_frame=True)
    assert normal.by_frame is not None
    blocks, slopes = normal.by_frame
    p, rules = len(problem.nominal), np.arange(len(problem.nominal) + BEND, problem.common)
    kept = np.concatenate([np.arange(p), rules])
    rest = np.setdiff1d(np.arange(problem.size), kept)
    # the board and the joints at rest follow the others
    reduced = np.zeros((problem.size + 1, len(kept)))
    reduced[kept] = np.eye(len(kept))
    reduced[rest] = -np.linalg.solve(
        normal.matrix[np.ix_(rest, rest)], normal.matrix[np.ix_(rest, kept)]
    )
    known = np.append(problem.precision, 0.0)
    poses, pose = np.unique(problem.frames.pose, return_inverse=True)
    information = np.zeros((len(poses), len(kept), len(kept)))
    gradients = np.zeros((len(poses), len(kept)))
    for frame, number in enumerate(pose):
        own = reduced[problem.columns[frame]]
        information[number] += own.T @ blocks[frame] @ own
        gradients[number] += slopes[frame] @ own
    prior = reduced.T @ (known[:, None] * reduced)
    return clustered_covariance(information, gradients, max(solution.noise, 1.0), prior)

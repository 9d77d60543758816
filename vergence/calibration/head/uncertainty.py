"""How surely a head's numbers are known: by what each pose has to say of them.

The errors of the frames of a pose go together, where the board is not as it is believed to be or a
joint gives way, so poses are what is counted, as views are in `vergence.calibration.uncertainty`.
"""

import numpy as np

from vergence.calibration.head.solution import HeadSolution
from vergence.calibration.uncertainty import clustered_covariance
from vergence.models.parts import FloatArray


def head_covariance(solution: HeadSolution) -> FloatArray:
    """(p, p) covariance of the numbers of `HeadModel.parameters`.

    Args:
        solution: the head and how it was found.
    """
    problem = solution.problem
    normal = problem.linearised(solution.state, solution.weights, by_frame=True)
    assert normal.by_frame is not None
    blocks, slopes = normal.by_frame
    p = len(problem.nominal)
    # the board and the joints at rest follow the head's numbers
    follow = np.linalg.solve(normal.matrix[p:, p:], normal.matrix[p:, :p])
    reduced = np.vstack([np.eye(p), -follow, np.zeros((1, p))])
    known = np.append(problem.precision, 0.0)
    poses, pose = np.unique(problem.frames.pose, return_inverse=True)
    information, gradients = np.zeros((len(poses), p, p)), np.zeros((len(poses), p))
    for frame, number in enumerate(pose):
        own = reduced[problem.columns[frame]]
        information[number] += own.T @ blocks[frame] @ own
        gradients[number] += slopes[frame] @ own
    prior = reduced.T @ (known[:, None] * reduced)
    return clustered_covariance(information, gradients, max(solution.noise, 1.0), prior)

"""Running the gaze task of any head: trials, a law that fits all, eyes with unequal images."""

import numpy as np

from tests.controllers.loops import begin
from tests.heads import text_of
from vergence.envs.task import GazeTask
from vergence.models import HeadModel, parse_head


def least_squares(task: GazeTask, gain: float) -> np.ndarray:
    """(num, m) actions by J A (J A)^+ with a depth of a metre: a law for any head."""
    head, own = task.head, task.head.actuation
    seen = task.layout.decode(task.observation)
    error = np.nan_to_num(seen.pixel_error)
    pixels = error + head.cameras.principal
    jacobian = head.image_jacobian(seen.positions_at_exposure, pixels, np.ones((task.num, 2)))
    by_actuator = jacobian[..., 3:].reshape(-1, 4, 4) @ own.to_joints
    inverse = np.linalg.pinv(by_actuator, rcond=1e-8)
    return task.layout.action(-gain * np.einsum("nij,nj->ni", inverse, error.reshape(-1, 4)))


def begun(
    head: HeadModel, num: int, *, plant: str = "kinematic", target: object = "random"
) -> GazeTask:
    return begin(GazeTask(num, head=head, plant=plant, target=target))


def uneven(name: str) -> HeadModel:
    """A head whose right eye has an image of another size and shape."""
    text = text_of(name).replace("[image]\nwidth_px = 320\nheight_px = 240\n", "")
    left, right = text.split('name = "right"\n', 1)
    left = left.replace(
        'name = "left"\nfocal', 'name = "left"\nwidth_px = 320\nheight_px = 240\nfocal'
    )
    right = right.replace("343.0, 343.0", "500.0, 500.0").replace("159.5, 119.5", "319.5, 179.5")
    return parse_head(left + 'name = "right"\nwidth_px = 640\nheight_px = 360\n' + right)

"""Posture of a head at rest: its links and cameras, its size, and the upright direction.

N defines the upright direction: its y axis points down. The article's frame 0 has z up, and its
head at rest looks along -y.
"""

from typing import Final, NamedTuple

import numpy as np

from vergence.models.geometry import DenavitHartenberg, chain_end, rot_z
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

ARTICLE_BASELINE_M: Final = 0.092
"""Baseline of the article's head, m; the shapes of other heads scale with it (physical: the
article's head)."""
EYE_RADIUS_M: Final = 0.018
"""Radius of the drawn eyeball, m (chosen: about the housing of a small camera module)."""
_N_UPRIGHT: Final = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""N's axes at rest in a frame with z up and -y forward (physical: the definition of N)."""
_N_ORIGIN_M: Final = (-0.011, -0.064, 0.0)
"""N's origin at rest in the article's frame 0, m (physical: the article's head)."""


class RestPoses(NamedTuple):
    """Poses of a head at rest: links, cameras, frame N and the upright frame, all in frame 0."""

    links: FloatArray
    """(B, 4, 4) poses of the links in frame 0, in the order of `Links.bodies`."""
    frame_n: FloatArray
    """(4, 4) T_0_N."""
    cameras: FloatArray
    """(2, 4, 4) poses of both cameras in frame 0."""
    upright_frame: FloatArray
    """(4, 4) pose in frame 0 of the upright frame: z up, -y forward, and N at the same pose in it
    as in the article's frame 0; the identity for the article's head."""
    eye_roots: FloatArray
    """(2, 3) positions in frame 0 of each eye's first joint, or of its camera if it does not move,
    m."""
    has_neck: bool
    is_article_head: bool
    """True if the head has the article's form."""

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras, m."""
        return float(np.linalg.norm(self.cameras[1, :3, 3] - self.cameras[0, :3, 3]))

    @property
    def scale(self) -> float:
        """Ratio of the size of the head's parts to the article's, from the baseline, 0.5 to 1.7."""
        if self.is_article_head:
            return 1.0
        return float(np.clip(self.baseline_m / ARTICLE_BASELINE_M, 0.5, 1.7))

    @property
    def eye_radius_m(self) -> float:
        """Radius of an eyeball, m; smaller for a narrow head, so that its eyes do not touch."""
        narrow = 1.0 if self.is_article_head else float(np.clip(self.baseline_m / 0.06, 0.1, 1.0))
        return EYE_RADIUS_M * narrow

    @property
    def bar_ends(self) -> FloatArray:
        """(2, 3) ends of a bar behind both eyes' first joints, in frame 0, metres."""
        return np.asarray(self.eye_roots - 1.6 * self.eye_radius_m * self.frame_n[:3, 2])

    @property
    def stand_top(self) -> FloatArray:
        """(3,) top of the stand in frame 0, metres: below the neck, or at the middle of the bar."""
        if self.is_article_head:
            return np.array([0.0, 0.0, -0.03])
        if self.has_neck:
            return np.asarray(self.links[0, :3, 3] - 0.03 * self.scale * self.upright_frame[:3, 2])
        return np.asarray(self.bar_ends.mean(axis=0))

    @property
    def lowest_m(self) -> float:
        """Height of the lowest joint or camera in the upright frame, m."""
        if self.is_article_head:
            return 0.0
        points = np.concatenate([self.links[:, :3, 3], self.cameras[:, :3, 3]])
        return float((self.upright_frame[:3, 2] @ (points - self.upright_frame[:3, 3]).T).min())


def rest_poses(head: HeadModel) -> RestPoses:
    """Compute the poses of a head's links, base and cameras at rest, and its upright frame."""
    q, links = head.rest(), head.links.bodies()
    frames: list[FloatArray] = []
    for body in links:
        parent = frames[body.parent] if body.parent >= 0 else np.eye(4)
        frames.append(parent @ body.pose @ rot_z(q[body.joints[0]]))
    base = head.base_pose(q)
    upright = np.eye(4)
    is_article = isinstance(head.links, DenavitHartenberg)
    if not is_article:
        upright[:3, :3] = base[:3, :3] @ _N_UPRIGHT.T
        upright[:3, 3] = base[:3, 3] - upright[:3, :3] @ _N_ORIGIN_M
    cameras = base @ head.camera_poses(q)
    carrier, *ends = n_and_camera_bodies(head)
    roots = np.array(cameras[:, :3, 3])
    for eye, end in enumerate(ends):
        if end != carrier:
            while links[end].parent != carrier:
                end = links[end].parent
            roots[eye] = frames[end][:3, 3]
    return RestPoses(
        links=np.array(frames).reshape(-1, 4, 4),
        frame_n=base,
        cameras=cameras,
        upright_frame=upright,
        eye_roots=roots,
        has_neck=carrier >= 0,
        is_article_head=is_article,
    )


def n_and_camera_bodies(head: HeadModel) -> tuple[int, int, int]:
    """Indices in `Links.bodies` of the bodies that carry N and both cameras; -1 for the base."""
    bodies = head.links.bodies()
    return chain_end(bodies, None), chain_end(bodies, 0), chain_end(bodies, 1)

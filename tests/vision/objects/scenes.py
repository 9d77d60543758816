"""Two eyes before textured planes, whose images and truth are computed ray by ray."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vergence import load_head
from vergence.models.camera import to_light
from vergence.models.parts import Rendering
from vergence.vision import Camera

SAMPLES = 2  # along each axis of a pixel
_LEVELS = np.interp(np.linspace(0, 1, 4096), to_light(np.linspace(0, 1, 4096), "srgb"),
                    np.linspace(0, 1, 4096))  # fmt: skip


class Card(NamedTuple):
    """A textured rectangle."""

    T_0_T: np.ndarray  # pose; x right, y down in the texture, z away from the viewer
    width_m: float
    light: NDArray[np.float32]  # 0 to 1


class Rig(NamedTuple):
    """Both eyes."""

    cameras: tuple[Camera, Camera]
    poses: np.ndarray  # (2, 4, 4) T_0_C
    rendering: Rendering


@lru_cache
def _head(name: str):
    return load_head(name)


def rig(name: str, looking_at: Sequence[float] = (0.0, 0.0, 1.0)) -> Rig:
    """A preset's eyes fixating a point before them."""
    head = _head(name)
    q = head.fixate(looking_at, warn=False)
    return Rig(
        (Camera.of(head, 0), Camera.of(head, 1)),
        head.base_pose(q) @ head.camera_poses(q),
        head.rendering,
    )


def ahead(one: Rig) -> np.ndarray:
    """Pose of the point between the eyes; x to the right eye, z ahead."""
    left, right = one.poses
    x = right[:3, 3] - left[:3, 3]
    x /= np.linalg.norm(x)
    z = left[:3, 2] + right[:3, 2]
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = (left[:3, 3] + right[:3, 3]) / 2
    return pose


def card(one: Rig, at: Sequence[float], turn: Sequence[float], width_m: float, light) -> Card:
    """A card at a place before the eyes, turned by a rotation vector."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, float))[0]
    pose[:3, 3] = at
    return Card(ahead(one) @ pose, width_m, light)


def noise_texture(rng: np.random.Generator, side: int = 1024, slope: float = 1.0) -> NDArray:
    """Octaves of smoothed noise, like plaster or leaves."""
    total = np.zeros((side, side), np.float32)
    cells = 8
    while cells <= side:
        grid = rng.normal(size=(cells, cells)).astype(np.float32)
        total += cv2.resize(grid, (side, side), interpolation=cv2.INTER_CUBIC) * cells ** -(
            slope / 2
        )
        cells *= 2
    total = (total - total.mean()) / total.std()
    return np.clip(0.4 + 0.2 * total, 0.0, 1.0)


def picture(path: str) -> NDArray:
    """Light of a photograph."""
    return to_light(cv2.imread(path, cv2.IMREAD_GRAYSCALE) / 255.0, "srgb").astype(np.float32)


def hits(cards: Sequence[Card], origin: np.ndarray, rays: np.ndarray):
    """Distances (n,) along rays of frame 0, which card (-1 for none), and (n, 2) shares of it."""
    best, which = np.full(len(rays), np.inf), np.full(len(rays), -1)
    shares = np.zeros((len(rays), 2))
    for k, (pose, width_m, light) in enumerate(cards):
        normal = pose[:3, 2]
        t = ((pose[:3, 3] - origin) @ normal) / (rays @ normal)
        flat = (origin + t[:, None] * rays - pose[:3, 3]) @ pose[:3, :2]
        x, y = flat[:, 0] / width_m, flat[:, 1] / width_m * light.shape[1] / light.shape[0]
        nearer = (np.abs(x) < 0.5) & (np.abs(y) < 0.5) & (t > 0.05) & (t < best)
        best[nearer], which[nearer] = t[nearer], k
        shares[nearer] = np.column_stack([x, y])[nearer] + 0.5
    return best, which, shares


@lru_cache(maxsize=4)
def _sample_rays(camera: Camera, region: tuple[int, int, int, int]) -> np.ndarray:
    x0, y0, x1, y1 = region
    u = x0 + (np.arange((x1 - x0) * SAMPLES) + 0.5) / SAMPLES - 0.5
    v = y0 + (np.arange((y1 - y0) * SAMPLES) + 0.5) / SAMPLES - 0.5
    rays = camera.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    return np.column_stack([rays, np.ones(len(rays))])


def paint(
    camera: Camera, T_0_C: np.ndarray, cards: Sequence[Card], rendering: Rendering,
    rng: np.random.Generator | None = None, *, smear_px=(0.0, 0.0), gain=1.0, offset=0.0,
    jpeg: int | None = None, near=None, reach_px: int = 120,
) -> NDArray[np.uint8]:  # fmt: skip
    """One eye's image: exact projection, sampling, blur, sRGB, noise and rounding.

    With a pixel, only the region around it is painted; the rest is plain.
    """
    region = (0, 0, *camera.size)
    if near is not None:
        (x, y), (width, height) = np.rint(near).astype(int), camera.size
        x, y = np.clip(x, reach_px, width - reach_px), np.clip(y, reach_px, height - reach_px)
        region = (x - reach_px, y - reach_px, x + reach_px, y + reach_px)
    x0, y0, x1, y1 = map(int, region)
    rays = _sample_rays(camera, (x0, y0, x1, y1)) @ T_0_C[:3, :3].T
    distance, which, shares = hits(cards, T_0_C[:3, 3], rays)
    shape = ((y1 - y0) * SAMPLES, (x1 - x0) * SAMPLES)
    image = np.full(shape, 0.4, np.float32)
    for k, (_, width_m, light) in enumerate(cards):
        mine = (which == k).reshape(shape)
        if not mine.any():
            continue
        nearest = distance[which == k].min()
        wanted = max(int(SAMPLES * camera.focal[0] * width_m / nearest), 2)
        if wanted < light.shape[1]:  # about a texel a sample
            size = (wanted, max(round(wanted * light.shape[0] / light.shape[1]), 2))
            light = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
        where = (shares * light.shape[::-1] - 0.5).astype(np.float32).reshape(*shape, 2)
        drawn = cv2.remap(light, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        image[mine] = drawn[mine]
    image = cv2.GaussianBlur(image, (0, 0), SAMPLES * max(rendering.blur_px, 0.2))
    length = np.hypot(*smear_px)
    if length > 0.1:
        count = int(np.ceil(2 * SAMPLES * length))
        moved = np.zeros_like(image)
        for share in (np.arange(count) + 0.5) / count - 0.5:
            shift = np.array([[1, 0, SAMPLES * share * smear_px[0]],
                              [0, 1, SAMPLES * share * smear_px[1]]])  # fmt: skip
            moved += cv2.warpAffine(image, shift, shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        image = moved / count
    image = cv2.resize(image, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    whole = np.full((camera.height, camera.width), 0.4, np.float32)
    whole[y0:y1, x0:x1] = image
    image = whole
    levels = _LEVELS[np.clip(np.rint(4095 * image), 0, 4095).astype(int)]
    grey = rendering.black_grey + (rendering.white_grey - rendering.black_grey) * levels
    grey = gain * grey + offset
    if rng is not None:
        grey = grey + rng.normal(0.0, rendering.noise_grey, grey.shape)
    done = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    if jpeg is not None:
        done = cv2.imdecode(cv2.imencode(".jpg", done, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], 0)
    return done


def seen_from(one: Rig, cards: Sequence[Card], pixel, eye: int = 0):
    """The surface point of a pixel in frame 0, and its pixel in the other eye, nan if hidden."""
    camera, pose = one.cameras[eye], one.poses[eye]
    ray = pose[:3, :3] @ np.append(camera.rays([pixel])[0], 1.0)
    distance, which, _ = hits(cards, pose[:3, 3], ray[None])
    if which[0] < 0:
        return np.full(3, np.nan), np.full(2, np.nan)
    point = pose[:3, 3] + distance[0] * ray
    return point, project(one, cards, point, 1 - eye)


def project(one: Rig, cards: Sequence[Card], point: np.ndarray, eye: int) -> np.ndarray:
    """The pixel of a point of frame 0 in an eye, nan if it is hidden or outside."""
    camera, pose = one.cameras[eye], one.poses[eye]
    inside = pose[:3, :3].T @ (point - pose[:3, 3])
    pixel = camera.project(inside[None])[0] if inside[2] > 0.01 else np.full(2, np.nan)
    distance, _, _ = hits(cards, pose[:3, 3], (point - pose[:3, 3])[None])
    border = np.minimum(pixel, np.subtract(camera.size, 1) - pixel).min()
    return pixel if distance[0] > 0.999 and border > 0 else np.full(2, np.nan)


def misread(
    one: Rig, rng: np.random.Generator, sigma_px: float, most_px: float = 2.0
) -> np.ndarray:
    """(2, 4, 4) poses with errors of the encoders, as pixels of the images."""
    poses = one.poses.copy()
    for pose, camera in zip(poses, one.cameras, strict=True):
        error_px = np.clip(rng.normal(0.0, sigma_px, 3), -most_px, most_px) * (1, 1, 0.3)
        pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(error_px / camera.focal[0])[0]
    return poses

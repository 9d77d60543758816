"""Measure how well points of textured scenes are found in the other eye and followed.

Run ``python -m benchmarks.points [PICTURE...]``. Scenes are planes at 0.4 to 2.5 m, slanted up to
60 degrees, before the eyes of both presets, textured by octaves of noise and by the pictures, with
noise, sRGB, gains that differ by eye, errors of the encoders and, for every third scene, JPEG.
"""

import argparse
import time
from collections import Counter
from math import hypot
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.vision.objects.scenes import (
    Card,
    Rig,
    card,
    hits,
    misread,
    noise_texture,
    paint,
    picture,
    project,
    rig,
    seen_from,
)
from vergence.errors import PointRefusedError
from vergence.vision.objects.matching import match_point
from vergence.vision.objects.patches import PointTracker

SUFFICIENT_PX = 0.05
"""Largest bound on a point's standard deviation that counts as sufficient texture: gradients are
then as strong as the noise, in the direction in which they are weakest."""
WINDOW_PX = 25
FALSE_PX = 2.0
POINTS_A_SCENE = 25

Pixel = NDArray[np.float64]


def bound_px(image: NDArray[np.uint8], pixel: Pixel, noise: float) -> float:
    """Bound on the standard deviation of a point by two noisy images, by one without noise."""
    side = (WINDOW_PX + 2, WINDOW_PX + 2)
    patch = cv2.getRectSubPix(image.astype(np.float32), side, (float(pixel[0]), float(pixel[1])))
    gy, gx = np.gradient(patch)
    g = np.stack([gx[1:-1, 1:-1].ravel(), gy[1:-1, 1:-1].ravel()])
    return float(np.sqrt(2.0 * noise**2 / max(np.linalg.eigvalsh(g @ g.T)[0], 1e-9)))


def on_one_surface(one: Rig, cards: list[Card], pixel: Pixel, eye: int) -> bool:
    """True if a window around a pixel shows one card only."""
    half = WINDOW_PX // 2 + 2
    steps = np.array([[i, j] for i in (-half, 0, half) for j in (-half, 0, half)])
    rays = np.column_stack([one.cameras[eye].rays(pixel + steps), np.ones(9)])
    return len(set(hits(cards, one.poses[eye][:3, 3], rays @ one.poses[eye][:3, :3].T)[1])) == 1


def slant(rng: np.random.Generator, most_rad: float) -> NDArray[np.float64]:
    """Rotation vector of a slanted card."""
    angle, turn = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.0, most_rad)
    return np.array([np.cos(angle) * turn, np.sin(angle) * turn, rng.uniform(-0.3, 0.3)])


def random_scene(rng: np.random.Generator, preset: str, pictures: list[Any]) -> tuple[Rig, Any]:
    """Background, and up to two cards before it."""

    def texture() -> Any:
        if pictures and rng.random() < 0.5:
            return pictures[rng.integers(len(pictures))]
        return noise_texture(rng, 1024, rng.uniform(0.2, 1.2))

    looking = [rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15), rng.uniform(0.4, 2.5)]
    one = rig(preset, tuple(looking))
    z = rng.uniform(1.0, 2.5)
    cards = [card(one, (0, 0, z), slant(rng, 0.7), 5.0, np.tile(texture(), (3, 3)))]
    for _ in range(rng.integers(0, 3)):
        z = rng.uniform(0.4, 1.2)
        at = (rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.3, 0.3) * z, z)
        cards.append(card(one, at, slant(rng, 1.0), rng.uniform(0.3, 0.6) * z, texture()))
    return one, cards


class Tally:
    """Counts and errors of points."""

    def __init__(self) -> None:
        """Start with none."""
        self.errors: list[float] = []
        self.squares: list[float] = []
        self.counts: Counter[str] = Counter()
        self.seconds: list[float] = []

    def add(self, error: Pixel, sigma: Pixel) -> bool:
        """Count a point that was found, true if it is a false one."""
        if not hypot(*error) <= FALSE_PX:
            self.counts["FALSE"] += 1
            return True
        self.errors.append(hypot(*error))
        self.squares += ((error / sigma) ** 2).tolist()
        return False

    def show(self, name: str) -> None:
        """Print all of it."""
        asked = len(self.errors) + sum(self.counts.values())
        refused = asked - len(self.errors) - self.counts["FALSE"]
        error = np.array(self.errors) if self.errors else np.array([np.nan])
        sizes = f"error {np.sqrt((error**2).mean()):.3f} px rms, {error.max():.2f} at most"
        squares = np.mean(self.squares) if self.squares else np.nan
        late = np.median(self.seconds) if self.seconds else np.nan
        print(
            f"{name}: {len(self.errors)} of {asked} found ({len(self.errors) / asked:.1%}), "
            f"{sizes}, "
            f"normalised {squares:.2f}; refused {refused}, false {self.counts['FALSE']}; "
            f"{1e3 * late:.2f} ms median"
        )
        for why, count in self.counts.most_common():
            print(f"    {count} {why}")


def attempt(tally: Tally, one: Rig, images: list[Any], poses: Any, pixel: Pixel, truth: Pixel,
            eye: int) -> bool:  # fmt: skip
    """Match one point."""
    begun = time.perf_counter()
    try:
        match = match_point(one.cameras, images, poses, pixel, eye)
    except PointRefusedError as refused:
        tally.counts[str(refused).rpartition(": ")[2].partition(" (")[0]] += 1
        return False
    finally:
        tally.seconds.append(time.perf_counter() - begun)
    return tally.add(match.pixel - truth, match.sigma_px)


def matching(count: int, rng: np.random.Generator, preset: str, pictures: list[Any]) -> None:
    """Points with texture of surfaces, and at edges of cards."""
    whole, edges, hidden, weak = (Tally() for _ in range(4))
    scene = 0
    while sum(whole.counts.values()) + len(whole.errors) < count:
        one, cards = random_scene(rng, preset, pictures)
        gains = rng.uniform(0.95, 1.05), rng.uniform(-5.0, 5.0)
        seen = [(1.0, 0.0), gains]
        clean = [
            paint(c, T, cards, one.rendering, gain=g, offset=o)
            for c, T, (g, o) in zip(one.cameras, one.poses, seen, strict=True)
        ]
        images: list[Any] = []
        for each in clean:
            noisy = each + rng.normal(0.0, one.rendering.noise_grey, each.shape)
            grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
            if scene % 3 == 2:
                coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
                grey = np.asarray(cv2.imdecode(coded, 0), np.uint8)
            images.append(grey)
        poses = misread(one, rng, 1.0)
        for _ in range(POINTS_A_SCENE):
            eye = int(rng.integers(2))
            pixel = rng.uniform(30.0, np.array(one.cameras[eye].size) - 31.0)
            _, truth = seen_from(one, cards, pixel, eye)
            size = np.array(one.cameras[1 - eye].size)
            if not ((truth > 24.0) & (truth < size - 25.0)).all():
                attempt(hidden, one, images, poses, pixel, truth, eye)
                continue
            if not (on_one_surface(one, cards, pixel, eye)
                    and on_one_surface(one, cards, truth, 1 - eye)):  # fmt: skip
                false = attempt(edges, one, images, poses, pixel, truth, eye)
            elif bound_px(clean[eye], pixel, one.rendering.noise_grey) > SUFFICIENT_PX:
                false = attempt(weak, one, images, poses, pixel, truth, eye)
            else:
                false = attempt(whole, one, images, poses, pixel, truth, eye)
            if false:
                print("    false:", preset, scene, eye, pixel, truth)
        scene += 1
    whole.show(f"{preset}, matching, sufficient texture")
    weak.show(f"{preset}, matching, weak texture")
    edges.show(f"{preset}, matching, at edges of cards")
    hidden.show(f"{preset}, matching, hidden from the other eye or at its border")


def refusals(count: int, rng: np.random.Generator, preset: str) -> None:
    """Points without texture, along epipolar lines, and of repeating patterns."""
    plain = np.full((64, 64), 0.4, np.float32)
    edge = np.where(np.arange(512)[:, None] < 256, 0.2, 0.6) * np.ones((1, 512))
    y, x = np.mgrid[:1024, :1024] // 32
    tiles = 0.3 + 0.3 * ((x + y) % 2)
    joints = np.where((np.mgrid[:1024, :1024] % 64 < 6).any(axis=0), 0.1, 0.5)
    for name, light in (("plain wall", plain), ("edge along the line", edge),
                        ("checks", tiles), ("tiles", joints)):  # fmt: skip
        tally, tracked = Tally(), 0
        for _ in range(count // 10):
            one = rig(preset, (0.0, 0.0, rng.uniform(0.5, 2.0)))
            z = rng.uniform(0.5, 2.0)
            turn = (rng.uniform(-0.4, 0.4), 0.0 if "edge" in name else rng.uniform(-0.4, 0.4), 0.0)
            cards = [card(one, (0, 0, z), turn, 4.0 * z, light.astype(np.float32))]
            images = [
                paint(c, T, cards, one.rendering, rng)
                for c, T in zip(one.cameras, one.poses, strict=True)
            ]
            for _ in range(10):
                pixel = rng.uniform(60.0, np.array(one.cameras[0].size) - 61.0)
                if "edge" in name:  # onto the edge
                    point = cards[0].T_0_T @ [rng.uniform(-0.3, 0.3) * z, 0.0, 0.0, 1.0]
                    pixel = project(one, cards, point[:3], 0) + rng.uniform(-4.0, 4.0, 2)
                _, truth = seen_from(one, cards, pixel)
                attempt(tally, one, images, misread(one, rng, 1.0), pixel, truth, 0)
                try:
                    PointTracker(one.cameras[0]).begin(images[0], pixel, one.poses[0])
                    tracked += 1
                except PointRefusedError:
                    pass
        tally.show(f"{preset}, {name} (trackers begun: {tracked})")


def tracking(count: int, rng: np.random.Generator, preset: str, pictures: list[Any]) -> None:
    """Points followed while the eye turns, in scenes at rest and moving ones."""
    tally, blurred, refused = Tally(), Tally(), 0
    for _ in range(count):
        one, cards = random_scene(rng, preset, pictures)
        camera, start = one.cameras[0], one.poses[0]
        pixel = rng.uniform(150.0, np.array(camera.size) - 151.0)
        point, _ = seen_from(one, cards, pixel)
        if not np.isfinite(point).all() or not on_one_surface(one, cards, pixel, 0):
            continue
        first = paint(camera, start, cards, one.rendering, None, near=pixel)
        if bound_px(first, pixel, one.rendering.noise_grey) > SUFFICIENT_PX:
            continue
        tracker = PointTracker(camera)
        read = misread(one, rng, 1.5)[0]
        try:
            tracker.begin(paint(camera, start, cards, one.rendering, rng, near=pixel), pixel, read)
        except PointRefusedError:
            refused += 1
            continue
        axis = rng.normal(size=3) * (1, 1, 0.3)
        axis /= np.linalg.norm(axis)
        most = rng.uniform(0.0, 0.05)  # rad an image: up to 6 rad/s at 120 Hz
        for step in range(1, 25):
            angle = 0.15 * most / 0.05 * np.sin(step * 0.33)
            change = 0.15 * most / 0.05 * 0.33 * np.cos(step * 0.33)
            pose = start.copy()
            pose[:3, :3] = start[:3, :3] @ cv2.Rodrigues(axis * angle)[0]
            now = one._replace(poses=np.stack([pose, one.poses[1]]))
            truth = project(now, cards, point, 0)
            if not np.isfinite(truth).all() or min(*truth, *(camera.size - truth)) < 20:
                continue
            flow = np.cross(axis, [0, 0, 1])[:2] * change * camera.focal
            smear = np.clip(0.3 * flow, -6.0, 6.0)
            image = paint(camera, pose, cards, one.rendering, rng, near=truth, smear_px=smear)
            here = blurred if hypot(*smear) > 1.0 else tally
            begun = time.perf_counter()
            found = tracker.find(image, misread(now, rng, 1.5)[0])
            here.seconds.append(time.perf_counter() - begun)
            if found is None:
                here.counts["not seen"] += 1
            else:
                here.add(found.pixel - truth, found.sigma_px)
    tally.show(f"{preset}, tracking ({refused} points refused)")
    blurred.show(f"{preset}, tracking, smears of 1 to 6 px")


def report() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("pictures", nargs="*", help="photographs for textures")
    parser.add_argument("--points", type=int, default=500, help="points of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--preset", nargs="*", default=["simulated", "physical"])
    parser.add_argument("--only", choices=["matching", "refusals", "tracking"])
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pictures = [picture(path) for path in options.pictures]
    for preset in options.preset:
        rng = np.random.default_rng(options.seed)
        if options.only in (None, "matching"):
            matching(options.points, rng, preset, pictures)
        if options.only in (None, "refusals"):
            refusals(max(options.points // 5, 10), rng, preset)
        if options.only in (None, "tracking"):
            tracking(options.points // 5, rng, preset, pictures)


if __name__ == "__main__":
    report()

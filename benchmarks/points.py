"""Measure how well points are found in the other eye, refused, and followed in whole gazes.

Run ``python -m benchmarks.points [PICTURE...]``. Scenes of pairs are planes at 0.4 to 2.5 m,
slanted up to 60 degrees, before the eyes of both presets, textured by octaves of noise and by the
pictures, with noise, sRGB, gains that differ by eye, errors of the encoders and, for every third
scene, JPEG.

A point has sufficient texture if the bound on its standard deviation, by the scene's own texture
without noise, the preset's noise in both images, and a window of 25 px, is below 0.1 px in the
direction in which it is largest. Nothing that the code under test computes decides that.

Photographs are rectified pairs with the disparity of each pixel, such as the motorcycle that the
package scikit-image ships: ``--photographs LEFT.png RIGHT.png DISPARITY.npz``. Points of their
surfaces have disparities within 2 px in their window; errors are those of the disparities, too.

Whole gazes are those of the law state-feedback, towards points of the room that the left eye sees
at the start, drawn without regard to texture but for the plain and the periodic part of its front.
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
from vergence import load_head
from vergence.controllers.controller import make_controller
from vergence.envs.plants.cameras import RoomImageRenderer
from vergence.envs.task import GazeTask
from vergence.errors import PointRefusedError
from vergence.models.camera import Camera
from vergence.vision.objects.patches import PointTracker
from vergence.vision.objects.points import match_point
from vergence.vision.objects.room import parse_scene
from vergence.vision.objects.walls import HIGH_M, PERIODIC_M, PLAIN_M

SUFFICIENT_PX = 0.1
"""Largest bound on a point's standard deviation that counts as sufficient texture."""
WINDOW_PX = 25
FALSE_PX = 2.0
POINTS_A_SCENE = 25
GAZE_STEPS = 120
AT_END = 30
"""Images of a gaze, and those at its end."""
SETTLED_PX = 1.0
"""Largest error of both eyes' gaze at the end."""

Pixel = NDArray[np.float64]


PHOTOGRAPH_NOISE = 2.0
"""Noise by which texture of photographs is sufficient, grey levels."""
SURFACE_PX = 2.1
"""Most that disparities of one surface differ by in a window."""


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

    def add(self, error: Pixel, sigma: Pixel) -> None:
        """Count a point that was found, a false one by itself."""
        if not hypot(*error) <= FALSE_PX:
            self.counts["FALSE"] += 1
            return
        self.errors.append(hypot(*error))
        self.squares += ((error / sigma) ** 2).tolist()

    @property
    def asked(self) -> int:
        """Number of points."""
        return len(self.errors) + sum(self.counts.values())

    def show(self, name: str) -> None:
        """Print a row of the table."""
        asked = max(self.asked, 1)
        false = self.counts["FALSE"]
        rms = np.sqrt(np.mean(np.square(self.errors))) if self.errors else np.nan
        squares = np.mean(self.squares) if self.squares else np.nan
        late = 1e3 * np.median(self.seconds) if self.seconds else np.nan
        why = ", ".join(f"{count} {each}" for each, count in self.counts.most_common(4))
        print(
            f"{name:44} {self.asked:6} {len(self.errors) / asked:7.1%} "
            f"{(asked - len(self.errors) - false) / asked:7.1%} {false / asked:7.2%} "
            f"{rms:7.3f} {squares:7.2f} {late:7.2f}  {why}",
            flush=True,
        )


def attempt(tally: Tally, cameras: Any, images: list[Any], poses: Any, pixel: Pixel,
            truth: Pixel, eye: int) -> None:  # fmt: skip
    """Match one point."""
    begun = time.perf_counter()
    try:
        match = match_point(cameras, images, poses, pixel, eye)
    except PointRefusedError as refused:
        tally.counts[str(refused).rpartition(": ")[2].partition(" (")[0]] += 1
        return
    finally:
        tally.seconds.append(time.perf_counter() - begun)
    tally.add(match.pixel - truth, match.sigma_px)


def matching(count: int, rng: np.random.Generator, preset: str, pictures: list[Any]) -> None:
    """Points with texture of surfaces, and at edges of cards."""
    whole, edges, hidden, weak = (Tally() for _ in range(4))
    scene = 0
    while whole.asked < count:
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
            point, truth = seen_from(one, cards, pixel, eye)
            if np.isnan(point).any():  # beside all cards, so that there is no truth
                continue
            size = np.array(one.cameras[1 - eye].size)
            if not ((truth > 24.0) & (truth < size - 25.0)).all():
                tally = hidden
            elif not (on_one_surface(one, cards, pixel, eye)
                      and on_one_surface(one, cards, truth, 1 - eye)):  # fmt: skip
                tally = edges
            elif bound_px(clean[eye], pixel, one.rendering.noise_grey) > SUFFICIENT_PX:
                tally = weak
            else:
                tally = whole
            if tally is not whole or whole.asked < count:
                attempt(tally, one.cameras, images, poses, pixel, truth, eye)
        scene += 1
    whole.show(f"{preset}, pairs, sufficient texture")
    weak.show(f"{preset}, pairs, weaker texture")
    edges.show(f"{preset}, pairs, at edges of cards")
    hidden.show(f"{preset}, pairs, hidden or at a border")


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
        while tally.asked < count:
            one = rig(preset, (0.0, 0.0, rng.uniform(0.5, 2.0)))
            z = rng.uniform(0.5, 2.0)
            turn = (rng.uniform(-0.4, 0.4), 0.0 if "edge" in name else rng.uniform(-0.4, 0.4), 0.0)
            cards = [card(one, (0, 0, z), turn, 4.0 * z, light.astype(np.float32))]
            images = [
                paint(c, T, cards, one.rendering, rng)
                for c, T in zip(one.cameras, one.poses, strict=True)
            ]
            for _ in range(min(10, count - tally.asked)):
                pixel = rng.uniform(60.0, np.array(one.cameras[0].size) - 61.0)
                if "edge" in name:  # onto the edge
                    point = cards[0].T_0_T @ [rng.uniform(-0.3, 0.3) * z, 0.0, 0.0, 1.0]
                    pixel = project(one, cards, point[:3], 0) + rng.uniform(-4.0, 4.0, 2)
                _, truth = seen_from(one, cards, pixel)
                attempt(tally, one.cameras, images, misread(one, rng, 1.0), pixel, truth, 0)
                try:
                    PointTracker(one.cameras[0]).begin(images[0], pixel, one.poses[0])
                    tracked += 1
                except PointRefusedError:
                    pass
        tally.show(f"{preset}, {name} ({tracked} followed)")


def photographs(count: int, rng: np.random.Generator, files: list[str]) -> None:
    """Points of a rectified pair of photographs; lengths are of no account."""
    left, right = (np.asarray(cv2.imread(file), np.uint8) for file in files[:2])
    disparity = np.load(files[2])["arr_0"]
    size, grey = np.array(left.shape[1::-1]), cv2.cvtColor(left, cv2.COLOR_BGR2GRAY)
    matrix = np.array([[1000.0, 0.0, size[0] / 2], [0.0, 1000.0, size[1] / 2], [0.0, 0.0, 1.0]])
    cameras = [Camera(size=(int(size[0]), int(size[1])), matrix=matrix)] * 2
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 0.2
    surfaces, edges = Tally(), Tally()
    half = WINDOW_PX // 2
    while surfaces.asked < count:
        u, v = rng.integers(30, size - 30).tolist()
        truth, pixel = np.array([u - disparity[v, u], v]), np.array([u, v], float)
        window = disparity[v - half : v + half + 1, u - half : u + half + 1]
        known = window[np.isfinite(window)]
        enough = bound_px(np.asarray(grey, np.uint8), pixel, PHOTOGRAPH_NOISE) <= SUFFICIENT_PX
        if not truth[0] > 24.0 or not np.isfinite(truth[0]) or not enough:
            continue
        surface = len(known) > 0.9 * window.size and np.ptp(known) < SURFACE_PX
        tally = surfaces if surface else edges
        attempt(tally, cameras, [left, right], poses, pixel, truth, 0)
    surfaces.show("photographs, surfaces")
    edges.show("photographs, at edges")


class Watched:
    """Search of an eye's images that is compared with the truth."""

    def __init__(self, own: Any, plant: Any, eye: int) -> None:
        """Watch a search."""
        self.own, self.plant, self.eye = own, plant, eye
        self.errors: list[Pixel] = []
        self.sigmas: list[Pixel] = []
        self.seconds: list[float] = []

    def look(self, image: Any, T_0_C: Any, time_s: float, *, search: bool = True) -> None:
        """Take an image, and compare."""
        begun = time.perf_counter()
        self.own.look(image, T_0_C, time_s, search=search)
        self.seconds.append(time.perf_counter() - begun)
        camera = Camera.of(self.plant.true_head, self.eye)
        truth = camera.project(self.plant._T_C_T[self.eye][None, :3, 3])[0]
        seen = self.own._found.detection
        nowhere = np.full(2, np.nan)
        if time_s >= 0.0:
            self.errors.append(nowhere if seen is None else seen.pixel - truth)
            self.sigmas.append(nowhere if seen is None else seen.sigma_px)

    def found(self) -> Any:
        """See `EyeSearch.found`."""
        return self.own.found()

    def forget(self) -> None:
        """See `EyeSearch.forget`."""
        self.own.forget()


def room_points(count: int, rng: np.random.Generator, preset: str) -> list[Pixel]:
    """Points of the room in N that the left eye sees at the start."""
    head = load_head(preset)
    views, camera = RoomImageRenderer(head, parse_scene("room")), Camera.of(head, 0)
    points: list[Pixel] = []
    while len(points) < count:
        pixel = rng.uniform(40.0, np.array(camera.size) - 41.0)
        point = views.surface(head.rest(), 0, pixel)  # N at rest is the room's frame
        near = [left - 0.1 < point[0] < right + 0.1 and top - 0.1 < point[1] < bottom + 0.1
                for left, top, right, bottom in (PLAIN_M, PERIODIC_M)]  # fmt: skip
        if not (any(near) and point[2] > HIGH_M[2] - 1e-3):
            points.append(point)
    return points


def gazes(count: int, rng: np.random.Generator, preset: str) -> None:
    """Whole gazes to points of the room."""
    tally, end, lost_at_end, settled, seconds = Tally(), Tally(), 0, 0, []
    for trial, point in enumerate(room_points(count, rng, preset)):
        place = {"kind": "static", "point": point.tolist(), "look": "point"}
        task = GazeTask(
            1, head=preset, plant="rendered", target=place, plant_options={"scene": "room"}
        )
        law, state = make_controller("state-feedback", head=task.head), None
        search = task.plant._searches[0]  # type: ignore[attr-defined]
        eyes = [Watched(own, task.plant, eye) for eye, own in enumerate(search.eyes)]
        search.eyes = tuple(eyes)
        task.begin(np.array([0]), np.array([0], np.uint64), np.array([trial], np.uint64))
        for step in range(GAZE_STEPS):
            command, state = law.predict(
                task.observation.copy(), state=state, episode_start=np.array([step == 0]),
                deterministic=True,
            )  # fmt: skip
            task.step(task.as_action(command))
        settled += bool((np.hypot(*task.truth().pixel_error[0].T) < SETTLED_PX).all())
        for eye in eyes:
            seconds += eye.seconds
            for late, (error, sigma) in enumerate(zip(eye.errors, eye.sigmas, strict=True)):
                here = [tally, end] if late >= len(eye.errors) - AT_END else [tally]
                for each in here:
                    if np.isnan(error).any():
                        each.counts["not seen"] += 1
                    else:
                        each.add(error, sigma)
        lost = any(np.isnan(eye.errors[-AT_END:]).all() for eye in eyes)
        lost_at_end += lost
        if lost:
            print(f"    lost: {np.round(point, 3)}: {search.shared.remark}")
        task.close()
    tally.seconds = end.seconds = seconds
    tally.show(f"{preset}, images of gazes ({settled} of {count} settled)")
    end.show(f"{preset}, at their ends ({lost_at_end} lost)")


def report() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("pictures", nargs="*", help="photographs for textures")
    parser.add_argument("--pairs", type=int, default=50, help="points of sufficient texture")
    parser.add_argument("--refused", type=int, default=20, help="points of each other kind")
    parser.add_argument("--gazes", type=int, default=4, help="whole gazes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--preset", nargs="*", default=["simulated", "physical"])
    parser.add_argument("--photographs", nargs=3, metavar="FILE", help="a pair and its disparities")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pictures = [picture(path) for path in options.pictures]
    columns = "".join(
        f"{name:>8}" for name in ("found", "refused", "false", "px rms", "norm.", "ms")
    )
    print(f"{'':44} {'points':>6}{columns}")
    if options.photographs:
        photographs(options.pairs, np.random.default_rng(options.seed), options.photographs)
        return
    for preset in options.preset:
        rng = np.random.default_rng(options.seed)
        if options.pairs:
            matching(options.pairs, rng, preset, pictures)
        if options.refused:
            refusals(options.refused, rng, preset)
        if options.gazes:
            gazes(options.gazes, rng, preset)


if __name__ == "__main__":
    report()

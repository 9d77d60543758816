"""Measure gazes at objects against gazes at a tag, in rendered images.

Run ``python -m benchmarks.objects`` with ``settle``, ``slow``, ``rest`` or ``depth``, and
``--count`` for the number of trials of each.

- settle: the same jumps of a tag, a ball and a textured point through the loop of the scenario
  `hardware`; time until both true errors stay below 2 px.
- slow: a ball that swings by up to 60 degrees a second; a detector that takes 100 ms, 10 times a
  second, and is carried by tracking, against a detector of every image whose images come 100 ms
  later.
- rest: a ball at rest and a detector that takes 1 s; true error and speed of the eyes in the second
  half of 6 s.
- depth: one fixation of a textured point; the error of depth by the images over its bound by the
  noise of pixels and encoders.
"""

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

from vergence import Noise, load_head, triangulate_views
from vergence.controllers import make_controller
from vergence.envs.task import GazeTask
from vergence.eval.trials.loops import HARDWARE_LOOP
from vergence.eval.trials.metrics import settle_time
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

LOOKS = {"tag": None, "ball": "colour:#ff8000", "point": "point"}
BALL = "colour:#ff8000"
BAND_PX = 2.0
PIXEL_PX = 0.09
"""Noise of a point's pixel, px: measured by ``benchmarks.points`` on the same head."""
SETTLE_S, SWING_S = 2.5, 6.0
SWING_M, SWING_RAD_S = 0.25, np.deg2rad(60.0)


class SlowBall:
    """An orange ball, found in one image out of twelve, and 100 ms late."""

    latency_s, rate_hz = 0.1, 10.0

    def __init__(self, camera: Any) -> None:
        from vergence.vision.objects.detectors import make_object_detector
        from vergence.vision.objects.targets import parse_gaze_target

        self._detector = make_object_detector(parse_gaze_target(BALL), camera)

    def detect(self, image: Any, hint: Any) -> Any:
        """See `vergence.vision.Detector`."""
        return self._detector.detect(image, hint)


class VerySlowBall(SlowBall):
    """The same, found once a second, and 1 s late."""

    latency_s, rate_hz = 1.0, 1.0


def run(
    task: GazeTask, law: str, steps: int, trial: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, s, true pixel errors (steps, 2, 2) and joint angles (steps, 7), rad, of a trial."""
    controller = make_controller(law, head=task.head)
    task.begin(np.zeros(1, int), np.zeros(1, np.uint64), np.full(1, trial, np.uint64))
    state, times, errors, angles = None, [], [], []
    for step in range(steps):
        action, state = controller.predict(
            task.observation.copy(), state=state, episode_start=np.array([step == 0])
        )
        task.step(task.as_action(action))
        truth = task.truth()
        assert truth is not None
        times.append(float(truth.time_s[0]))
        errors.append(truth.pixel_error[0].copy())
        angles.append(truth.positions[0].copy())
    return np.array(times), np.array(errors), np.array(angles)


def jump(head: HeadModel, rng: np.random.Generator) -> dict[str, Any]:
    """A jump between two points that both eyes see, before and after it."""
    size, border = head.cameras.size, 60.0
    while True:
        before, after = rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 2.0], (2, 3))
        q = head.fixate(before, head.rest()[:3], warn=False)
        ends = np.array([q, head.fixate(after, head.rest()[:3], warn=False)])
        if not head.reaches(ends).all():
            continue
        pixels = head.project(q, after)
        if ((pixels > border) & (pixels < size - border)).all():
            return {"kind": "step", "before": before.tolist(), "after": after.tolist()}


def settle(count: int, law: str) -> None:
    """Compare settle times of the same jumps."""
    head = load_head("physical")
    loop = replace(HARDWARE_LOOP, detection_noise_px=None, skew_s=None, model_errors=None)
    steps = round(SETTLE_S * head.timing.control_rate_hz)
    times: dict[str, list[float]] = {name: [] for name in LOOKS}
    for trial in range(count):
        target = jump(head, np.random.default_rng(trial))
        for name, look in LOOKS.items():
            options: dict[str, Any] = {"width_rad": "fit"} if look is None else {"look": look}
            task = GazeTask(
                1, head=head, plant="rendered", target=target, variation=loop, plant_options=options
            )
            time_s, errors, _ = run(task, law, steps, trial)
            task.close()
            times[name].append(float(settle_time(time_s, errors, BAND_PX)))
    tag = np.array(times["tag"])
    for name, taken in times.items():
        own = np.array(taken)
        both = np.isfinite(own) & np.isfinite(tag)
        print(
            f"{law}, {name}: {np.isfinite(own).mean():.0%} of {count} settle, median "
            f"{1e3 * np.nanmedian(own):.0f} ms, {np.median(own[both] / tag[both]):.3f} of the tag's"
        )


def slow(count: int, law: str) -> None:
    """Compare errors of a slow detector with those of a fast one with the same delay."""
    head = load_head("physical")
    steps = round(SWING_S * head.timing.control_rate_hz)
    results: dict[str, list[float]] = {}
    for trial in range(count):
        depth_m = np.random.default_rng(trial).uniform(0.6, 1.5)
        target = {
            "kind": "circle", "centre": [0.0, -0.1, depth_m], "radius": SWING_M * depth_m,
            "period": 2 * np.pi * SWING_M / SWING_RAD_S, "start": "fixation",
        }  # fmt: skip
        for name, look, late_s in (("slow", f"{__name__}:SlowBall", 0.0), ("fast", BALL, 0.1)):
            options = {"look": look, "latency_s": head.timing.latency_s + late_s}
            task = GazeTask(1, head=head, plant="rendered", target=target, plant_options=options)
            time_s, errors, _ = run(task, law, steps, trial)
            task.close()
            late = time_s > 0.5 * SWING_S
            rms = float(np.sqrt(np.square(errors[late]).sum(axis=-1).mean()))
            results.setdefault(name, []).append(rms)
    for name, rms_px in results.items():
        print(f"{law}, {name}: error {np.median(rms_px):.2f} px rms (median of {count})")
    ratio = np.array(results["slow"]) / np.array(results["fast"])
    print(f"{law}: slow over fast {np.median(ratio):.2f}")


def rest(count: int, law: str) -> None:
    """Measure how still the eyes are before a ball at rest with a very slow detector."""
    head = load_head("physical")
    rate_hz = head.timing.control_rate_hz
    loop = replace(HARDWARE_LOOP, detection_noise_px=None, skew_s=None, model_errors=None)
    errors_px, speeds = [], []
    for trial in range(count):
        target = {"kind": "static", "point": jump(head, np.random.default_rng(trial))["before"]}
        task = GazeTask(
            1, head=head, plant="rendered", target=target, variation=loop,
            plant_options={"look": f"{__name__}:VerySlowBall"},
        )  # fmt: skip
        _, errors, angles = run(task, law, round(SWING_S * rate_hz), trial)
        task.close()
        late = slice(len(errors) // 2, None)
        errors_px.append(float(np.linalg.norm(errors[late], axis=-1).max()))
        speeds.append(float(np.rad2deg(np.abs(np.diff(angles[late], axis=0)).max() * rate_hz)))
    print(
        f"{law}, at rest: error at most {max(errors_px):.2f} px, speed at most {max(speeds):.1f} "
        f"degrees/s, of {count}"
    )


def depth(count: int, law: str) -> None:
    """Compare errors of depth with their bound."""
    head = load_head("physical")
    steps = round(SETTLE_S * head.timing.control_rate_hz)
    step_rad = head.sensor.encoder_resolution_rad  # uniform within a step
    noise = Noise(pixel_px=PIXEL_PX, joint_rad=step_rad / np.sqrt(12.0))
    errors = []
    for trial in range(count):
        point = jump(head, np.random.default_rng(trial))["after"]
        task = GazeTask(
            1,
            head=head,
            plant="rendered",
            target={"kind": "static", "point": point, "look": "point"},
        )
        run(task, law, steps, trial)
        reading = task.reading
        fix = triangulate_views(head, reading.positions_at_exposure, reading.pixels, noise=noise)
        errors.append((fix.point[0, 2] - point[2]) / fix.sigma[0, 2])
        task.close()
    print(f"depth: {np.sqrt(np.nanmean(np.square(errors))):.2f} of its bound, rms of {count}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["settle", "slow", "rest", "depth"])
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--law", default="state-feedback")
    args = parser.parse_args()
    {"settle": settle, "slow": slow, "rest": rest, "depth": depth}[args.what](args.count, args.law)


if __name__ == "__main__":
    main()

"""Small valid inputs and run folders, made by the commands themselves, to be damaged."""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from tests.campaigns.harness import fresh, run
from tests.hardware.test_config import document
from tests.heads import text_of
from tests.models.files.pairs import opencv_pair, write_opencv
from tests.recording.logged import log_trials
from vergence.models.head_file import load_head, save_head
from vergence.models.toml_table import toml_text
from vergence.vision import AprilTag, Camera, TargetRenderer

TRAIN: Final = (
    "--set", "envs=8", "episode_steps=20", "network=[8]", "critic=[8]", "evaluations=3",
    "episodes=3", "algorithm.n_steps=16", "algorithm.batch_size=128", "algorithm.n_epochs=1",
)  # fmt: skip
STEPS: Final = ("--steps", "512")
REPRODUCE: Final = (
    "reproduce", "time-response", "--quick", "--workers", "1", "--out", "r",
    "--set", "time-response.trials=4", "time-response.delays_frames=[0,8]",
    "time-response.threshold_step_px=2.0", "time-response.duration_s=1.0",
)  # fmt: skip
TUNE: Final = (
    "tune", "pid", "--trials", "3", "--episodes", "4", "--workers", "1", "--out", "t",
)  # fmt: skip
EVALUATE: Final = ("evaluate", "ibvs", "--episodes", "4", "--workers", "1", "--out", "e")
GAZE: Final = ("gaze", "--plant", "kinematic", "--duration", "0.1")
URDF: Final = (
    "import", "urdf", "robot.urdf", "--base", "base", "--neck", "neck_pitch", "neck_roll",
    "neck_yaw", "--left-camera", "left_camera",
    "--right-camera", "right_camera", "--no-figure", "--out", "new.toml",
)  # fmt: skip
STEREO: Final = ("import", "stereo", "pair.yml", "--no-figure", "--out", "new.toml")
LOCATE: Final = (
    "locate", "i0/a.png", "i1/a.png", "--head", "simulated", "--target", "tag:36h11:5:120",
)  # fmt: skip
LEARN: Final = ("train", "gain-schedule", *STEPS, "--out", "w", *TRAIN)
MAKE: Final = (
    (*LOCATE, "--joints", "q.json", "--out", "l"),
    (*GAZE, "--out", "g"),
    EVALUATE,
    LEARN,
    ("export", "bundle", "w", "b.vgp"),
    ("export", "mjcf", "--out", "m"),
    ("export", "urdf", "--head", "any.toml", "--out", "u"),
    REPRODUCE,
    TUNE,
)
WARM: Final = ((*GAZE, "--out", "g"), EVALUATE, REPRODUCE, TUNE)
"""Commands whose machine code the others can begin with."""
CONTROLLER: Final = """\
import numpy as np


class Gentle:
    def __init__(self, head, layout):
        self.layout = layout

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        seen = self.layout.decode(observation)
        return self.layout.action(np.zeros(seen.velocities.shape[:-1] + (4,))), state
"""
OPTIONS: Final = "[ibvs]\ngain = 3.0\n\n[pid.workspace]\nproportional = 2.0\n"
OVERRIDES: Final = "[time-response]\ntrials = 3\ngain = 4.5\npoint_mm = [0.0, -145.0, 1500.0]\n"


def make(folder: Path) -> Path:
    """A folder with a head, a controller, and a run folder of each command."""
    fresh(folder)
    save_head(load_head("simulated"), folder / "head.toml")
    robot = document()
    robot["bus"]["port"] = "no/such/port"
    for name, text in (
        ("any.toml", text_of("tied")),
        ("mine.py", CONTROLLER),
        ("options.toml", OPTIONS),
        ("overrides.toml", OVERRIDES),
        ("robot.toml", toml_text(robot)),
    ):
        (folder / name).write_text(text, encoding="utf-8")
    write_opencv(folder / "pair.yml", opencv_pair())
    log_trials(folder / "run.mcap", steps=8)
    make_photographs(folder)
    for words in MAKE:
        outcome = run(words, folder, 120.0)
        # a gaze of a tenth of a second does not settle, and says so
        allowed = (0, 1) if words[0] == "gaze" else (0,)
        assert outcome.code in allowed, f"{' '.join(words)}: {outcome.code}: {outcome.err}"
    shutil.copy(folder / "u" / "tied.urdf", folder / "robot.urdf")
    with zipfile.ZipFile(folder / "b.vgp") as bundle:
        (network,) = (name for name in bundle.namelist() if name.endswith(".onnx"))
        (folder / "b.onnx").write_bytes(bundle.read(network))
    return folder


def make_photographs(folder: Path) -> None:
    """A tag as both eyes of `simulated` see it, each in a folder of its own, and the joints."""
    head, target = load_head("simulated"), AprilTag(id=5)
    pose = np.eye(4)
    pose[:3, 3] = (0.0, -0.1, 1.0)
    q = head.fixate(pose[:3, 3])
    for eye, T_N_C in enumerate(head.camera_poses(q)):
        drawing = TargetRenderer(Camera.of(head, eye), target, head.rendering)
        drawing.draw(np.linalg.inv(T_N_C) @ pose, np.random.default_rng(eye))
        (folder / f"i{eye}").mkdir()
        cv2.imwrite(str(folder / f"i{eye}" / "a.png"), drawing.frame)
    angles = dict(zip(head.joints, q.tolist(), strict=True))
    (folder / "q.json").write_text(json.dumps(angles), encoding="utf-8")
    rows = [",".join(map(str, values)) for values in (angles, angles.values())]
    (folder / "q.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")

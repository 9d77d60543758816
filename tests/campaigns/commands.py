"""Fuzzing of the command line and of every file that it reads.

    python -m tests.campaigns commands                 # ten minutes
    python -m tests.campaigns commands --minutes 1 --seed 7

Words are drawn and files are damaged by hypothesis. No command may show a stack trace, end with
another exit code than 0, 1, 2 or 130, or leave something half-written. A command that takes
longer than the limit is stopped and counted, which is no fault: a person may ask for much.
"""

import argparse
import re
import shutil
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from hypothesis import strategies as st

from tests.campaigns import corpus
from tests.campaigns.harness import Outcome, fresh, load, run, try_each, warm
from vergence.files import PARTIAL_PREFIX

_WORDS: Final = 24
"""Command lines in a round (chosen: balance of the kinds of cases)."""
_DAMAGES: Final = 2
"""Damages of each file in a round (chosen: balance of the kinds of cases)."""

HOSTILE: Final = (
    "", " ", "-", "--", "nan", "inf", "-inf", "-1", "0", "1", "0.5", "1e-300", "1e309", "2**3",
    "99999999999999999999", "None", "true", "[]", "{}", "[1,2]", "a" * 300, "a" * 5000, ".", "..",
    "/", "/dev/null", "/dev/full", "/proc/1/mem", "no/such/file", "../x", "head.toml", "g", "e",
    "w", "t", "r", "b.vgp", "any.toml", "robot.urdf", "pair.yml", "mine.py", "mine:Gentle",
    "mine:Nothing", "os:system", "a:b:c", ":",
    "physical", "simulated", "👁", "é", "\udcff", "$HOME", "%s", "{0}", "[bold]", "[/]", "a=b",
    "=", "a.b.c=1", "postgresql://u:p@127.0.0.1:1/x", "sqlite:///x", "127.0.0.1:1", "x.onnx",
)  # fmt: skip
"""Words that no option expects, or that some do."""
COMMANDS: Final[dict[str, tuple[tuple[str, ...], dict[str, tuple[str, ...]]]]] = {
    "gaze": (
        ("--plant", "kinematic", "--duration", "0.05"),
        {
            "--target": ("0 -100 1000", "100 -150 1500", "0 0 -5", "1e9 0 1", "nan 0 1", "1 2"),
            "--head": ("simulated", "turrets", "any.toml", "head.toml", "mine.py", "b.vgp"),
            "--gain": ("4", "1000", "-4"),
            "--plant": ("kinematic", "mujoco", "rendered", "mine:Gentle"),
            "--controller": ("ibvs", "pid", "saccade", "pursuit", "learned-gain", "nothing"),
            "--duration": ("0.02", "0.1", "-1", "1e9"),
            "--seed": ("0", "7", "-1", "18446744073709551615"),
            "--out": ("new", "g", "head.toml", "new/deep/er", "/proc/x"),
            "--json": (),
        },
    ),
    "evaluate": (
        ("--episodes", "2", "--workers", "1"),
        {
            "": ("ibvs", "pid", "saccade", "b.vgp", "mine:Gentle", "mine.py:Gentle", "x:y"),
            "--scenario": ("workspace", "step", "robust", "fast", "nothing"),
            "--plant": ("kinematic", "mujoco", "rendered", "nothing"),
            "--episodes": ("1", "2", "0", "-3", "1.5"),
            "--seed": ("0", "1048576", "-1"),
            "--head": ("simulated", "physical", "head.toml", "any.toml"),
            "--options": ("options.toml", "head.toml"),
            "--workers": ("1", "0", "-1", "10000"),
            "--out": ("new", "e", "g", "head.toml"),
            "--json": (),
            "--tune": (),
        },
    ),
    "train": (
        ("gain-schedule", *corpus.STEPS, *corpus.TRAIN),
        {
            "": ("policy", "nothing"),
            "--head": ("physical", "head.toml"),
            "--scenario": ("robust", "fast", "nothing"),
            "--plant": ("kinematic", "mujoco", "rendered"),
            "--seed": ("1", "-1", "4294967296"),
            "--steps": ("512", "0", "-1", "1"),
            "--envs": ("8", "0", "-1", "3"),
            "--inputs": ("errors", "nothing"),
            "--randomise": (),
            "--no-randomise": (),
            "--resume": ("w", "g", "nothing"),
            "--set": ("network=[]", "algorithm.gamma=2", "algorithm.learning_rate=1e30", "x=1"),
            "--out": ("new", "w", "head.toml"),
        },
    ),
    "tune": (
        ("pid", "--trials", "1", "--episodes", "2", "--workers", "1"),
        {
            "": ("ibvs", "adaptive", "fuzzy", "state-feedback", "saccade", "nothing"),
            "--scenario": ("step", "fast", "nothing"),
            "--trials": ("1", "0", "-1"),
            "--episodes": ("1", "0", "-1"),
            "--head": ("physical", "head.toml"),
            "--plant": ("mujoco", "rendered", "nothing"),
            "--seed": ("1", "-1"),
            "--storage": ("x.db", "head.toml", "no/such/x.db", "/dev/full"),
            "--study": ("x", "a/b"),
            "--out": ("new", "t", "g", "head.toml"),
            "--write": (),
        },
    ),
    "reproduce": (
        corpus.REPRODUCE[1:],
        {
            "": ("gain-sweep", "nothing"),
            "--out": ("new", "r", "g", "head.toml"),
            "--seed": ("1", "-1"),
            "--config": ("overrides.toml", "head.toml", "b.vgp"),
            "--include": ("e", "g", "r", "nothing"),
            "--set": (
                "time-response.gain=-1", "time-response.point_mm=[1,2]", "time-response.head=3",
                "time-response.threshold_step_px=0", "time-response.delays_frames=[]",
                "time-response.trials=-1", "gain-sweep.gain_step=0", "time-response.gain.x=1",
            ),
        },
    ),
    "export": (
        (),
        {
            "": ("mjcf", "urdf", "bundle", "w", "g", "new.vgp", "b.vgp"),
            "--head": ("simulated", "icub", "head.toml", "any.toml", "mine.py"),
            "--out": ("new", "m", "g", "head.toml"),
            "--checkpoint": ("best", "last", "worst"),
            "--force": (),
        },
    ),
    "import urdf": (
        corpus.URDF[2:],
        {
            "": ("pair.yml", "head.toml"),
            "--base": ("N", "left_camera", "nothing"),
            "--left-camera": ("right_camera", "base", "nothing"),
            "--neck": ("neck_pitch", "neck_yaw", "left_pan", "nothing"),
            "--lock": ("neck_pitch=10", "neck_yaw=nan", "left_pan", "eyes_tilt=1e9", "x=0.1m"),
            "--camera-axes": ("x,y,z", "-y,-z,x", "x,x,y", "right,down,forward"),
            "--speed": ("1", "-1", "left_pan=2", "nothing=2", "left_pan=nan"),
            "--acceleration": ("1", "0", "left_pan=2", "nothing=2"),
            "--actuators": ("common-tilt", "version-vergence", "nothing"),
            "--intrinsics": ("pair.yml", "robot.urdf"),
            "--name": ("a", "../x"),
            "--out": ("new.toml", "head.toml", "g", "new/deep/er.toml"),
            "--force": (),
        },
    ),
    "import stereo": (
        corpus.STEREO[2:],
        {
            "": ("robot.urdf", "head.toml", "nothing.yml"),
            "--unit": ("m", "cm", "mm", "inch"),
            "--size": ("640x480", "640", "0x0", "99999x99999"),
            "--lens": ("brown-conrady", "rational", "fisheye", "pinhole"),
            "--name": ("a", "../x"),
            "--out": ("new.toml", "head.toml", "g", "new/deep/er.toml"),
            "--swap": (),
            "--force": (),
        },
    ),
    "locate": (
        ("i0", "i1", "--head", "simulated", "--target", "tag:36h11:5:120"),
        {
            "": ("i0/a.png", "l", "pair.yml", "nothing.png"),
            "--head": ("icub", "head.toml", "any.toml", "pair.yml"),
            "--target": ("tag:36h11", "checkerboard:5x4:40", "charuco:7x5:40:30:4X4_50", "tag"),
            "--joints": ("q.json", "q.csv", "head.toml", "i0/a.png"),
            "--out": ("new", "l", "g", "head.toml"),
            "--json": (),
        },
    ),
    "detect": (
        ("i0", "--target", "tag:36h11"),
        {
            "": ("i1/a.png", "g", "pair.yml"),
            "--target": ("tag:16h5:3:50", "checkerboard:5x4", "checkerboard:0x0", "tag"),
            "--head": ("simulated", "any.toml"),
            "--eye": ("left", "right", "both"),
            "--camera": ("pair.yml", "head.toml"),
            "--figure": ("new.png", "new.xyz", "g", "no/such/new.png"),
            "--live": ("i0/a.png", "99", "pair.yml", "nothing"),
            "--seconds": ("0.1", "-1", "nan"),
            "--json": (),
        },
    ),
    "deploy": (
        ("ibvs", "--config", "robot.toml"),
        {
            "": ("mine.py:Gentle", "b.vgp", "nothing"),
            "--config": ("head.toml", "options.toml", "nothing.toml"),
            "--gazes": ("3", "0", "-1"),
            "--duration": ("0.1", "0", "-1", "1e9", "nan"),
            "--options": ("options.toml", "head.toml"),
            "--log": ("new.mcap", "run.mcap", "g", "no/such/new.mcap"),
            "--dry-run": (),
            "--images": (),
            "--json": (),
        },
    ),
    "replay": (
        ("run.mcap",),
        {
            "": ("head.toml", "g", "nothing.mcap"),
            "--controller": ("ibvs", "state-feedback", "mine.py:Gentle", "b.vgp", "nothing"),
            "--options": ("options.toml", "head.toml"),
            "--gaze": ("1", "2", "3", "0", "-1"),
            "--out": ("new", "g", "run.mcap"),
            "--parquet": (),
            "--json": (),
        },
    ),
    "info": (
        (),
        {
            "--head": ("simulated", "turrets", "any.toml", "pair.yml"),
            "--json": (),
            "--figure": ("new.png", "new.xyz", "g", "no/such/new.png"),
        },
    ),
}  # fmt: skip
"""For each command words that make it short, and its options with what they may be given."""
FILES: Final[dict[str, tuple[str, ...]]] = {
    "head.toml": (*corpus.GAZE, "--head", "head.toml"),
    "any.toml": ("info", "--head", "any.toml"),
    "robot.urdf": corpus.URDF,
    "pair.yml": corpus.STEREO,
    "overrides.toml": (*corpus.REPRODUCE, "--config", "overrides.toml"),
    "options.toml": ("evaluate", "ibvs", "--episodes", "2", "--workers", "1", "--options",
                     "options.toml"),
    "mine.py": ("evaluate", "mine.py:Gentle", "--episodes", "2", "--workers", "1"),
    "i1/a.png": (*corpus.LOCATE, "--joints", "q.json"),
    "q.json": (*corpus.LOCATE, "--joints", "q.json"),
    "q.csv": (*corpus.LOCATE, "--joints", "q.csv"),
    "b.vgp": ("evaluate", "b.vgp", "--episodes", "2", "--workers", "1"),
    "b.onnx": ("evaluate", "b.onnx", "--episodes", "2", "--workers", "1"),
    "e/section.json": (*corpus.REPRODUCE, "--include", "e"),
    "w/config.toml": ("train", "--resume", "w", "--steps", "640"),
    "w/head.toml": ("train", "--resume", "w", "--steps", "640"),
    "w/checkpoints/last.pt": ("train", "--resume", "w", "--steps", "640"),
    "w/checkpoints/best.pt": ("export", "bundle", "w", "new.vgp"),
    "r/experiments/time-response.json": corpus.REPRODUCE,
    "r/tables/time-response.csv": corpus.REPRODUCE,
    "r/figures/*.svg": corpus.REPRODUCE,
    "r/config.toml": corpus.REPRODUCE,
    "run.mcap": ("replay", "run.mcap", "--controller", "ibvs"),
    "robot.toml": ("deploy", "ibvs", "--config", "robot.toml"),
    "t/study.db": corpus.TUNE,
    "t/tune.json": corpus.TUNE,
}  # fmt: skip
"""Files that commands read, each with such a command."""

_TOKEN: Final = re.compile(rb'"[^"\n]*"|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\b[A-Za-z_][\w-]*\b')
_VALUES: Final = (
    b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-9", b"true", b"null", b'""', b'"../../../x"',
    b"[]", b"{}", b"99999999999999999999", b'"\\u0000"', b"[[[[1]]]]", b"\xff", b"3", b'"a"',
    b'"' + 400 * b"a" + b'"', b"\xef\xbb\xbf", b"1979-05-27", b"", b"head", b"import os\n",
)  # fmt: skip

Draw = Callable[[st.SearchStrategy[Any]], Any]


@st.composite
def command_lines(draw: Draw) -> tuple[str, ...]:
    """A command with some of its options, and sometimes with words that belong nowhere."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    short, options = COMMANDS[command]
    words = list(short)
    for option in draw(st.lists(st.sampled_from(sorted(options)), max_size=3, unique=True)):
        values = options[option]
        given_ = draw(st.sampled_from(values) if values else st.just(""))
        if draw(st.integers(0, 3)) == 0:
            given_ = draw(st.sampled_from(HOSTILE))
        elif option == "--target" and given_:
            words += [option, *given_.split()]
            continue
        where = [option] if option else []
        # a positional word comes first, where another is expected already
        words = [given_, *words] if not where else words + where + ([given_] if given_ else [])
    for _ in range(draw(st.sampled_from((0, 0, 0, 1, 2)))):
        place = draw(st.integers(0, len(words)))
        words.insert(place, draw(st.sampled_from(HOSTILE)))
    if draw(st.integers(0, 9)) == 0:
        return tuple(words)
    return (*command.split(), *words)


@st.composite
def damages(draw: Draw) -> tuple[tuple[str, int, bytes], ...]:
    """Strategy for damages of a file: kind, position in millionths of its length, new bytes."""
    kinds = st.sampled_from(
        ("token", "token", "token", "flip", "cut", "end", "insert", "gone", "folder", "empty")
    )
    step = st.tuples(kinds, st.integers(0, 999_999), st.sampled_from(_VALUES))
    return tuple(draw(st.lists(step, min_size=1, max_size=3)))


def damage(path: Path, steps: tuple[tuple[str, int, bytes], ...]) -> None:
    """Damage a file."""
    for kind, where, value in steps:
        if not path.is_file():
            return
        content = path.read_bytes()
        place = where * len(content) // 1_000_000
        if kind == "gone":
            path.unlink()
        elif kind == "folder":
            path.unlink()
            path.mkdir()
        elif kind == "empty":
            path.write_bytes(b"")
        elif kind == "end":
            path.write_bytes(content[:place])
        elif kind == "cut":
            path.write_bytes(content[:place] + content[place + 20 :])
        elif kind == "insert":
            path.write_bytes(content[:place] + value + content[place:])
        elif kind == "flip" and content:
            flipped = bytes([content[place] ^ (1 << where % 8)])
            path.write_bytes(content[:place] + flipped + content[place + 1 :])
        elif kind == "token":
            found = list(_TOKEN.finditer(content))
            if found:
                token = found[where * len(found) // 1_000_000]
                path.write_bytes(content[: token.start()] + value + content[token.end() :])


class Fuzz:
    """Tries cases and keeps what came of them.

    Args:
        folder: working folder.
        limit_s: time limit of a command, s.
        keep: folder that receives the folders of faults; None to drop them.
    """

    def __init__(self, folder: Path, limit_s: float, keep: Path | None) -> None:
        self._model = corpus.make(folder / "corpus")
        with zipfile.ZipFile(self._model / "b.vgp") as bundle:
            name = next(name for name in bundle.namelist() if name.endswith(".onnx"))
            (self._model / "b.onnx").write_bytes(bundle.read(name))
        self._case = folder / "case"
        self._limit_s = limit_s
        self._keep = keep
        self.codes: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = {}

    def words(self, words: tuple[str, ...]) -> None:
        """Try a command line."""
        fresh(self._case, self._model)
        self._judge(run(words, self._case, self._limit_s), "")

    def file(self, name: str, steps: tuple[tuple[str, int, bytes], ...]) -> None:
        """Try a command on a damaged file."""
        fresh(self._case, self._model)
        path = next(iter(sorted(self._case.glob(name))), self._case / name)
        damage(path, steps)
        self._judge(run(FILES[name], self._case, self._limit_s), f"{name} after {steps}: ")

    def _judge(self, outcome: Outcome, what: str) -> None:
        stopped = outcome.code is None and outcome.seconds >= self._limit_s
        self.codes["stopped" if stopped else str(outcome.code)] += 1
        found = outcome.faults()
        if outcome.code is None and not stopped:
            found.append("ended by a signal")
        if not stopped and list(self._case.rglob(f"{PARTIAL_PREFIX}*")):
            found.append("something half-written")
        if not found:
            return
        last = outcome.err.strip().splitlines()[-1:] or [""]
        key = f"{', '.join(found)}: {re.sub(r'[0-9]+', 'N', last[0])[:120]}"
        cases = self.faults.setdefault(key, [])
        cases.append(f"{what}{outcome.words}")
        if len(cases) == 1:
            print(f"FAULT {key}\n  {what}{outcome.words}\n{outcome.err[-1500:]}", flush=True)
            if self._keep is not None:
                shutil.copytree(self._case, self._keep / f"{len(self.faults):03d}", symlinks=True)


def main(arguments: list[str]) -> int:
    """Fuzz; 1 if there was a fault."""
    parser = argparse.ArgumentParser(
        "tests.campaigns commands", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=20.0, help="of a command")
    parser.add_argument("--keep", type=Path, help="folder for the files of faults")
    parser.add_argument("--only", help="words, or a file of " + ", ".join(FILES))
    options = parser.parse_args(arguments)
    begun = time.monotonic()
    load()
    warm(corpus.WARM)
    with tempfile.TemporaryDirectory() as folder:
        fuzz = Fuzz(Path(folder), options.limit_s, options.keep)
        rounds = 0
        while time.monotonic() - begun < 60.0 * options.minutes:
            _round(fuzz, options.seed * 1_000_003 + rounds, options.only)
            rounds += 1
            said = ", ".join(f"{code}: {n}" for code, n in sorted(fuzz.codes.items()))
            print(f"{time.monotonic() - begun:.0f} s, by exit code {said}", flush=True)
    for key, cases in fuzz.faults.items():
        print(f"{len(cases)} x {key}\n  {cases[0]}")
    print(f"{sum(fuzz.codes.values())} commands, {len(fuzz.faults)} kinds of fault")
    return 1 if fuzz.faults else 0


def _round(fuzz: Fuzz, number: int, only: str | None) -> None:
    """A few cases of each kind."""
    if only in (None, "words"):
        try_each(command_lines(), fuzz.words, number, _WORDS)
    for place, name in enumerate(FILES):
        if only in (None, name):
            try_each(damages(), partial(fuzz.file, name), 97 * number + place, _DAMAGES)

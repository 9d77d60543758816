"""Fuzzing of the command line and of every file that it reads.

Words are drawn and files are damaged by hypothesis. No command may show a stack trace, end with
another exit code than 0, 1, 2 or 130, or leave something half-written. A command that takes
longer than the limit is stopped and counted, which is no fault: a person may ask for much.
"""

import re
from functools import partial
from pathlib import Path
from typing import Any, Final

from hypothesis import strategies as st

from tests.campaigns import corpus
from tests.campaigns.harness import Findings, fresh, load, options_of, rounds, run, try_each
from vergence.files import PARTIAL_PREFIX

_WORDS: Final = 24
"""Command lines in a round (chosen: balance of the kinds of cases)."""
_DAMAGES: Final = 2
"""Damages of each file in a round (chosen: balance of the kinds of cases)."""
_LIMIT_S: Final = 20.0
"""Time limit of a command, s (chosen: some ask for more, which shows nothing new)."""

HOSTILE: Final = (
    "", " ", "-", "--", "nan", "-inf", "-1", "0", "0.5", "1e-300", "1e309", "2**3", "[1,2]",
    "99999999999999999999", "None", "{}", "a" * 5000, ".", "/", "/dev/full", "/proc/1/mem", "../x",
    "no/such/file", "head.toml", "g", "e", "w", "t", "r", "b.vgp", "any.toml", "robot.urdf",
    "pair.yml", "mine.py", "mine:Gentle", "mine:Nothing", "os:system", "a:b:c", ":", "physical",
    "👁", "é", "\udcff", "$HOME", "%s", "{0}", "[bold]", "[/]", "a=b", "=", "a.b.c=1",
    "postgresql://u:p@127.0.0.1:1/x", "sqlite:///x", "127.0.0.1:1", "x.onnx",
)  # fmt: skip
"""Words that no option expects, or that some do."""
_FEW: Final = ("--episodes", "2", "--workers", "1")
SHORT: Final[dict[str, tuple[str, ...]]] = {
    "gaze": ("--plant", "kinematic", "--duration", "0.05"),
    "evaluate": _FEW,
    "train": ("gain-schedule", *corpus.STEPS, *corpus.TRAIN),
    "tune": ("pid", "--trials", "1", *_FEW),
    "reproduce": corpus.REPRODUCE[1:],
    "import urdf": corpus.URDF[2:],
    "import stereo": corpus.STEREO[2:],
    "locate": ("i0", "i1", *corpus.LOCATE[3:]),
    "detect": ("i0", "--target", "tag:36h11"),
    "deploy": ("ibvs", "--config", "robot.toml"),
    "replay": ("run.mcap",),
}
"""Words that make a command short."""
_OPTIONS: Final = """
gaze: --point=0,-100,1000|100,-150,1500|0,0,-5|1e9,0,1|nan,0,1|1,2
    --head=simulated|turrets|any.toml|head.toml|mine.py|b.vgp --gain=4|1000|-4
    --plant=kinematic|mujoco|rendered|mine:Gentle
    --controller=ibvs|pid|saccade|pursuit|learned-gain|nothing --duration=0.02|0.1|-1|1e9
    --seed=0|7|-1|18446744073709551615 --out=new|g|head.toml|new/deep/er|/proc/x --json
evaluate: =ibvs|pid|saccade|b.vgp|mine:Gentle|mine.py:Gentle|x:y
    --scenario=workspace|step|robust|fast|nothing --plant=kinematic|mujoco|rendered|nothing
    --episodes=1|2|0|-3|1.5 --seed=0|1048576|-1 --head=simulated|physical|head.toml|any.toml
    --options=options.toml|head.toml --workers=1|0|-1|10000 --out=new|e|g|head.toml --json --tune
train: =policy|nothing --head=physical|head.toml --scenario=robust|fast|nothing
    --plant=kinematic|mujoco|rendered --seed=1|-1|4294967296 --steps=512|0|-1|1 --envs=8|0|-1|3
    --inputs=errors|nothing --randomise --no-randomise --resume=w|g|nothing
    --set=network=[]|algorithm.gamma=2|algorithm.learning_rate=1e30|x=1 --out=new|w|head.toml
tune: =ibvs|adaptive|fuzzy|state-feedback|saccade|nothing --scenario=step|fast|nothing
    --trials=1|0|-1 --episodes=1|0|-1 --head=physical|head.toml --plant=mujoco|rendered|nothing
    --seed=1|-1 --storage=x.db|head.toml|no/such/x.db|/dev/full --study=x|a/b
    --out=new|t|g|head.toml --write
reproduce: =gain-sweep|nothing --out=new|r|g|head.toml --seed=1|-1
    --config=overrides.toml|head.toml|b.vgp --include=e|g|r|nothing
    --set=time-response.gain=-1|time-response.point_mm=[1,2]|time-response.head=3
    --set=time-response.threshold_step_px=0|time-response.delays_frames=[]|time-response.trials=-1
    --set=gain-sweep.gain_step=0|time-response.gain.x=1
export: =mjcf|urdf|bundle|w|g|new.vgp|b.vgp --head=simulated|icub|head.toml|any.toml|mine.py
    --out=new|m|g|head.toml --checkpoint=best|last|worst --force
import urdf: =pair.yml|head.toml --base=N|left_camera|nothing
    --left-camera=right_camera|base|nothing --neck=neck_pitch|neck_yaw|left_pan|nothing
    --lock=neck_pitch=10|neck_yaw=nan|left_pan|eyes_tilt=1e9|x=0.1m
    --camera-axes=x,y,z|-y,-z,x|x,x,y|right,down,forward
    --speed=1|-1|left_pan=2|nothing=2|left_pan=nan --acceleration=1|0|left_pan=2|nothing=2
    --actuators=common-tilt|version-vergence|nothing --intrinsics=pair.yml|robot.urdf --name=a|../x
    --out=new.toml|head.toml|g|new/deep/er.toml --force
import stereo: =robot.urdf|head.toml|nothing.yml --unit=m|cm|mm|inch
    --size=640x480|640|0x0|99999x99999 --lens=brown-conrady|rational|fisheye|pinhole --name=a|../x
    --out=new.toml|head.toml|g|new/deep/er.toml --swap --force
locate: =i0/a.png|l|pair.yml|nothing.png --head=icub|head.toml|any.toml|pair.yml
    --target=tag:36h11|checkerboard:5x4:40|charuco:7x5:40:30:4X4_50|tag
    --joints=q.json|q.csv|head.toml|i0/a.png --out=new|l|g|head.toml --json
detect: =i1/a.png|g|pair.yml --target=tag:16h5:3:50|checkerboard:5x4|checkerboard:0x0|tag
    --head=simulated|any.toml --eye=left|right|both --camera=pair.yml|head.toml
    --figure=new.png|new.xyz|g|no/such/new.png --live=i0/a.png|99|pair.yml|nothing
    --seconds=0.1|-1|nan --json
deploy: =mine.py:Gentle|b.vgp|nothing --config=head.toml|options.toml|nothing.toml --gazes=3|0|-1
    --duration=0.1|0|-1|1e9|nan --options=options.toml|head.toml
    --log=new.mcap|run.mcap|g|no/such/new.mcap --dry-run --images --json
replay: =head.toml|g|nothing.mcap --controller=ibvs|state-feedback|mine.py:Gentle|b.vgp|nothing
    --options=options.toml|head.toml --gaze=1|2|3|0|-1 --out=new|g|run.mcap --parquet --json
info: --head=simulated|turrets|any.toml|pair.yml --json --figure=new.png|new.xyz|g|no/such/new.png
"""
"""The options of each command, one without a name for its other words, and some of their values."""


def _options(rows: str) -> dict[str, tuple[str, ...]]:
    options: dict[str, tuple[str, ...]] = {}
    for row in rows.split():
        name, _, values = row.partition("=")
        options[name] = options.get(name, ()) + tuple(values.split("|"))
    return options


COMMANDS: Final = {
    name: _options(rows) for name, rows in re.findall(r"^([a-z ]+):((?: .*\n)+)", _OPTIONS, re.M)
}
_RESUME: Final = ("train", "--resume", "w", "--steps", "640")
FILES: Final[dict[str, tuple[str, ...]]] = {
    "head.toml": (*corpus.GAZE, "--head", "head.toml"),
    "any.toml": ("info", "--head", "any.toml"),
    "robot.urdf": corpus.URDF,
    "pair.yml": corpus.STEREO,
    "overrides.toml": (*corpus.REPRODUCE, "--config", "overrides.toml"),
    "options.toml": ("evaluate", "ibvs", *_FEW, "--options", "options.toml"),
    "mine.py": ("evaluate", "mine.py:Gentle", *_FEW),
    **dict.fromkeys(("i1/a.png", "q.json"), (*corpus.LOCATE, "--joints", "q.json")),
    "q.csv": (*corpus.LOCATE, "--joints", "q.csv"),
    **{name: ("evaluate", name, *_FEW) for name in ("b.vgp", "b.onnx")},
    "e/section.json": (*corpus.REPRODUCE, "--include", "e"),
    **dict.fromkeys(("w/config.toml", "w/head.toml", "w/checkpoints/last.pt"), _RESUME),
    "w/checkpoints/best.pt": ("export", "bundle", "w", "new.vgp"),
    "r/experiments/time-response.json": corpus.REPRODUCE,
    "r/tables/time-response.csv": corpus.REPRODUCE,
    **dict.fromkeys(("r/figures/*.svg", "r/config.toml"), corpus.REPRODUCE),
    "run.mcap": ("replay", "run.mcap", "--controller", "ibvs"),
    "robot.toml": ("deploy", "ibvs", "--config", "robot.toml"),
    **dict.fromkeys(("t/study.db", "t/tune.json"), corpus.TUNE),
}
"""Files that commands read, each with such a command."""

_TOKEN: Final = re.compile(rb'"[^"\n]*"|-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\b[A-Za-z_][\w-]*\b')
_VALUES: Final = (
    b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-9", b"true", b"null", b'""', b'"../../../x"',
    b"[]", b"{}", b"99999999999999999999", b'"\\u0000"', b"[[[[1]]]]", b"\xff", b"3", b'"a"',
    b'"' + 400 * b"a" + b'"', b"\xef\xbb\xbf", b"1979-05-27", b"", b"head", b"import os\n",
)  # fmt: skip
Steps = tuple[tuple[str, int, bytes], ...]


@st.composite
def command_lines(draw: Any) -> tuple[str, ...]:
    """A command with some of its options, and sometimes with words that belong nowhere."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    words, options = list(SHORT.get(command, ())), COMMANDS[command]
    for option in draw(st.lists(st.sampled_from(sorted(options)), max_size=3, unique=True)):
        value = draw(st.sampled_from(options[option]))
        if draw(st.integers(0, 3)) == 0:
            value = draw(st.sampled_from(HOSTILE))
        # a positional word comes first, where another is expected already
        several = filter(None, value.split(",") if option == "--point" else [value])
        words = [*words, option, *several] if option else [value, *words]
    for _ in range(draw(st.sampled_from((0, 0, 0, 1, 2)))):
        words.insert(draw(st.integers(0, len(words))), draw(st.sampled_from(HOSTILE)))
    return tuple(words if draw(st.integers(0, 9)) == 0 else [*command.split(), *words])


@st.composite
def damages(draw: Any) -> Steps:
    """Damages of a file: kind, position in millionths of its length, new bytes."""
    kinds = st.sampled_from(
        ("token", "token", "token", "flip", "cut", "end", "insert", "gone", "folder", "empty")
    )
    step = st.tuples(kinds, st.integers(0, 999_999), st.sampled_from(_VALUES))
    return tuple(draw(st.lists(step, min_size=1, max_size=3)))


def damage(path: Path, steps: Steps) -> None:
    """Damage a file."""
    for kind, where, value in steps:
        if not path.is_file():
            return
        content = path.read_bytes()
        place = where * len(content) // 1_000_000
        before, after = content[:place], content[place:]
        if kind in ("gone", "folder"):
            path.unlink()
            if kind == "folder":
                path.mkdir()
            return
        if kind == "token" and (found := list(_TOKEN.finditer(content))):
            token = found[where * len(found) // 1_000_000]
            before, after = content[: token.start()] + value, content[token.end() :]
        elif kind == "empty":
            before = after = b""
        elif kind == "end":
            after = b""
        elif kind == "cut":
            after = after[20:]
        elif kind == "insert":
            before += value
        elif kind == "flip" and content:
            after = bytes((after[0] ^ (1 << where % 8),)) + after[1:]
        path.write_bytes(before + after)


class Fuzz:
    """Tries commands, and files that they read, in a folder."""

    def __init__(self, folder: Path, found: Findings) -> None:
        self._model = corpus.make(folder / "corpus")
        self._case = folder / "case"
        self._found = found

    def words(self, words: tuple[str, ...], name: str = "", steps: Steps = ()) -> None:
        """Try a command line, with a file damaged."""
        fresh(self._case, self._model)
        if name:
            damage(min(self._case.glob(name), default=self._case / name), steps)
        outcome = run(words, self._case, _LIMIT_S)
        stopped = outcome.code is None and outcome.seconds >= _LIMIT_S
        self._found.ends["stopped" if stopped else f"exit code {outcome.code}"] += 1
        faults = outcome.faults()
        if outcome.code is None and not stopped:
            faults.append("ended by a signal")
        if not stopped and list(self._case.rglob(f"{PARTIAL_PREFIX}*")):
            faults.append("something half-written")
        if faults:
            last = re.sub(r"[0-9]+", "N", outcome.err.strip().rpartition("\n")[2])[:120]
            kind = f"{', '.join(faults)}: {last}"
            self._found.add(kind, f"{name} {steps} {words}", outcome.err, self._case)


def main(words: list[str], folder: Path) -> Findings:
    """Fuzz."""
    only = ("words", *FILES)
    options = options_of(__doc__ or "", words, minutes=10.0, seed=0, keep="", only=only)
    load(corpus.WARM)
    found = Findings(Path(options.keep) if options.keep else None)
    fuzz = Fuzz(folder, found)
    for number in rounds(options.minutes, options.seed):
        if "words" in options.only:
            try_each(command_lines(), fuzz.words, number, _WORDS)
        for place, name in enumerate(FILES):
            if name in options.only:
                attempt = partial(fuzz.words, FILES[name], name)
                try_each(damages(), attempt, 97 * number + place, _DAMAGES)
        found.show("commands")
    return found

"""Fuzzing of what a robot is given: its configuration, its log, and its streams.

Whatever comes, there is an answer or one error of the package, each of whose lines is a line; no
warning, no hang, no memory without bound, and nothing that the input names is run.
"""

import base64
import json
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final
from unittest import mock

from hypothesis import strategies as st

from tests.campaigns import forged_logs, forged_streams
from tests.campaigns.commands import damage, damages
from tests.campaigns.harness import Findings, forked, options_of, rounds, try_each
from tests.hardware.fakes import HEAD, TAG, camera_config
from tests.hardware.test_config import document
from vergence.controllers.controller import CONTROLLERS
from vergence.errors import VergenceError
from vergence.eval.robot.config import ReplayConfig
from vergence.eval.robot.replay import replay
from vergence.hardware.cameras import EyeThread
from vergence.hardware.config import load_hardware
from vergence.hardware.drive import JointHistory
from vergence.hardware.dynamixel import bus as dynamixel_bus
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.dynamixel.control_table import PRESENT_POSITION
from vergence.hardware.dynamixel.packets import MOST_LENGTH, PacketParser, status_packet
from vergence.models.head_file import head_to_toml
from vergence.models.toml_table import toml_text
from vergence.recording.log import read_log, recover_log
from vergence.vision.objects.search import HeadSearch

_LIMIT_S: Final = 15.0
"""Time limit of one input, s (chosen: far longer than any takes)."""
_STREAM_S: Final = 2.5
"""Time for which an eye watches a stream, s (chosen: enough for several images)."""
_MEMORY: Final = 2**20
"""Additional memory of one input, KiB (chosen: images of 64 megapixels fit)."""
_STREAM_MEMORY: Final = 4 * 2**20
"""Additional memory of a stream, KiB (chosen: data of a local one until FFmpeg gives up)."""
_FORBIDDEN: Final = ("os.system", "os.exec", "os.posix_spawn", "subprocess.Popen",
                     "pickle.find_class", "ctypes.dlopen")  # fmt: skip
"""Audit events that no input may cause."""

_SPECIAL: Final = (
    "nan", "-inf", "-1", "0", "1e300", "true", '""', '" "', "[]", "{}", "[[]]", "1979-05-27",
    "0x" + "f" * 9000, "9" * 5000, "[" * 30000 + "]" * 30000, '"a\\nb"', '"\\u001b[31m"',
    '"\\u0000"', '"/dev/zero"', '"/dev/stdin"', '"FIFO"', '"FIFO.toml"', '"."', '"evil.py:X"',
    '"robot.toml"', '"../x"', '"/proc/self/mem"', '"tag:36h11:5:1e999"', '"checkerboard:0x0"',
    '"tag:36h11:99999999999999999999"', '"charuco:7x5:40:30:4X4_50"', '"\\u0663"',
    '"checkerboard:99999999x99999999:1"', '"tag:' + "9" * 5000 + '"', '"http://[::1"',
    '"' + "a" * 5000 + '"', "[1, 2, 3]", "{a = 1}", "2048", "1", '"left_pan"', '"simulated"',
    '"h:99999"', "[nan, 1]", "0.001",
)  # fmt: skip
_KEYS: Final = ("x", '"a\\nb"', '"\\u001b"', '""', "head", "port", "servos", "safety", "id", "'é'")

_ran: list[str] = []
_watching = False


def _audit(event: str, given_: tuple[object, ...]) -> None:
    # what numba keeps of kernels are pickles, of its own classes
    ours = event == "pickle.find_class" and given_[0] not in ("evil", "os", "posix", "subprocess")
    if _watching and event.startswith(_FORBIDDEN) and not ours:
        _ran.append(event)


sys.addaudithook(_audit)


class FaultError(Exception):
    """An input that leads to something that nobody should see."""


def _too_late(*_: object) -> None:
    raise FaultError(f"no end within {_LIMIT_S:g} s")


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Look for what nobody should see; the list gets the word for how it ended.

    Raises:
        FaultError: there is something.
    """
    global _watching
    ended: list[str] = []
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    former = signal.signal(signal.SIGALRM, _too_late)
    signal.setitimer(signal.ITIMER_REAL, _LIMIT_S)
    _watching = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield ended
        ended.append("answer")
    except FaultError:
        raise
    except VergenceError as error:
        ended.append(type(error).__name__)
        said = error.lines
        sound = [line.strip() and line.isprintable() and len(line) <= 3000 for line in said]
        if not sound or not all(sound) or str(error) != "\n".join(said):
            raise FaultError(f"no message of short lines: {str(error)!r:.300}") from error
    except Exception as error:
        raise FaultError(f"{type(error).__name__}: {error}"[:300]) from error
    finally:
        _watching = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if grown > _MEMORY:
        raise FaultError(f"{grown >> 10} MiB more memory")
    if _ran or (folder / "ran").exists():
        (folder / "ran").unlink(missing_ok=True)
        raise FaultError(f"run: {[_ran.pop() for _ in list(_ran)]}")


class Inputs:
    """Tries inputs, each in its own way, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.found = Findings()
        (folder / "evil.py").write_text(
            f"open({str(folder / 'ran')!r}, 'w').close()\nclass X: pass\n"
        )
        for name in ("FIFO", "FIFO.toml"):
            os.mkfifo(folder / name)
        (folder / "head.toml").write_text(head_to_toml(HEAD))
        self.text = _config_text()
        self.whole = forged_logs.parts(folder)
        self.images = ["", "AAAA", "====", "\u00e9", "A" * 999, *(
            base64.b64encode(one).decode() for one in forged_streams.pictures()
        )]  # fmt: skip

    def config(self, case: tuple[Any, ...]) -> None:
        """Read a configuration whose lines, and then whose bytes, are damaged."""
        lines, steps = case
        text = self.text.splitlines()
        for kind, where, value, key in lines:
            at = where % len(text)
            name = text[at].partition("=")[0]
            if kind == "value" and "=" in text[at]:
                text[at] = f"{name}= {value}"
            elif kind == "key":
                text[at] = f"{key} = {value}"
            elif kind == "more":
                text.insert(at, f"{key} = {value}")
            elif kind == "without":
                text[at] = ""
            else:
                text.insert(at, text[where // 7 % len(text)])
        path = self.folder / "robot.toml"
        if path.is_dir():
            path.rmdir()
        path.write_text("\n".join(text), encoding="utf-8")
        damage(path, steps)
        with watched(self.folder) as ended:
            load_hardware(path)
        self.found.ends.update(ended)

    def log(self, case: tuple[tuple[forged_logs.Edit, ...], str]) -> None:
        """Read a log, look at it again, and recover it."""
        steps, law = case
        path, out = self.folder / "run.mcap", self.folder / "recovered.mcap"
        path.write_bytes(forged_logs.forged(self.whole, steps, self.images))
        out.unlink(missing_ok=True)
        with watched(self.folder) as ended:
            log = read_log(path)
            for trial in log.trials[:3]:
                for step in range(min(trial.steps, 3)):
                    trial.frames(step)
            named = log.facts.get("controller")
            word = named if law and named in CONTROLLERS else law or None
            found = replay(ReplayConfig(log=path, controller=word))
            json.dumps(found.summary(), allow_nan=False)
            found.trajectory()
        self.found.ends.update(ended)
        with watched(self.folder) as again:
            recover_log(path, out)
            read_log(out)
        if "answer" in ended and "answer" not in again:
            raise FaultError(f"recovered, it can be read no more: {again}")

    def stream(self, script: forged_streams.Script) -> None:
        """Let an eye look at a stream, in a process of its own."""
        said = self.folder / "said"

        def look() -> int:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            said.write_text(_look(script)[:4000], encoding="utf-8", errors="replace")
            return 0

        said.unlink(missing_ok=True)
        code, seconds, memory = forked(look, _LIMIT_S)
        if code != 0:
            raise FaultError(f"the process ended by {code} after {seconds:.0f} s")
        grown = memory - resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if grown > _STREAM_MEMORY:
            raise FaultError(f"{grown >> 10} MiB more memory")
        if said.read_text("utf-8").startswith("FAULT "):
            raise FaultError(said.read_text("utf-8"))
        self.found.ends[said.read_text("utf-8")] += 1

    def line(self, case: tuple[tuple[bytes, ...], bool]) -> None:
        """Take packets out of bytes, and let a bus ask a line that answers with them."""
        pieces, babbles = case
        with watched(self.folder) as ended:
            parser = PacketParser()
            for piece in pieces:
                parser.feed(piece)
                if len(parser) > MOST_LENGTH + 6:
                    raise FaultError(f"{len(parser)} bytes are kept")
            parser.clear()
            if len(parser.feed(status_packet(7))) != 1:
                raise FaultError("a whole packet after these bytes is not found")
            line = forged_streams.ForgedLine(pieces, babbles)
            with mock.patch.object(dynamixel_bus, "SerialLine", return_value=line):
                bus = Bus("forged")
            begun_s = time.monotonic()
            bus.sync_read((1, 2, 3, 4), 126, 10)
            bus.ping(1)
            if time.monotonic() - begun_s > 1.0:
                raise FaultError("a question takes more than a second")
            bus.read(1, PRESENT_POSITION)
        self.found.ends.update(ended)

    def judge(self, name: str, attempt: Callable[[Any], None], case: Any) -> None:
        """Try an input and keep its fault."""
        try:
            attempt(case)
        except FaultError as fault:
            self.found.ends["fault"] += 1
            cause = fault.__cause__
            trace = "".join(traceback.format_exception(cause)) if cause else ""
            places = [line for line in trace.splitlines() if line.startswith("  File")]
            kind = f"{name}: {''.join(c for c in str(fault)[:90] if not c.isdigit())}"
            kind += f" {places[-1].strip()[-110:]}" if places else ""
            self.found.add(kind, f"{name} {case!r:.1500}", trace)

    def attempts(self) -> dict[str, tuple[Any, Callable[[Any], None]]]:
        """Strategy and way to try by name of input."""
        laws = st.sampled_from(("", "", "state-feedback", "ibvs", "pid"))
        return {
            "config": (configs(), self.config),
            "log": (st.tuples(forged_logs.edits(), laws), self.log),
            "stream": (forged_streams.scripts(), self.stream),
            "line": (st.tuples(forged_streams.lines(), st.booleans()), self.line),
        }


@st.composite
def configs(draw: Any) -> tuple[Any, ...]:
    """Edits of a configuration's lines, and sometimes of its bytes."""
    kinds = st.sampled_from(("value", "value", "value", "key", "more", "without", "twice"))
    words = (st.sampled_from(_SPECIAL), st.sampled_from(_KEYS))
    lines = st.lists(st.tuples(kinds, st.integers(0, 2**16), *words), min_size=1, max_size=3)
    return draw(lines), draw(damages()) if draw(st.integers(0, 3)) == 0 else ()


def _config_text() -> str:
    """A configuration with every key."""
    values = document() | {
        "head": "head.toml",
        "head_digest": HEAD.digest,
        "emulator": {"address": "127.0.0.1:4711"},
        "places": [
            {"target": f"tag:36h11:{n}:90", "point_mm": [10.0, -20.0, 900.0]} for n in (1, 2)
        ],
        "safety": {
            "speed_rad_s": 3.0, "acceleration_rad_s2": 40.0, "image_age_s": 0.5, "lost_s": 0.5,
            "search": True, "overruns": 0.3,
            "forbidden": [{"name": "frame", "left_pan": [0.9, 1.2]}],
        },
    }  # fmt: skip
    for servo in values["servos"]:
        servo |= {"gear_ratio": 1.0, "lower_rad": -0.1, "upper_rad": 0.1}
    for name, eye in values["cameras"].items():
        eye |= {"source": f"http://127.0.0.1:1/{name}", "pixel_format": "MJPG"}
        eye |= {"latency_s": 0.1, "exposure_s": 0.008}
    values["cameras"]["pairing_tolerance_s"] = 0.02
    return toml_text(values)


def _look(script: forged_streams.Script) -> str:
    """Fault of an eye after it has watched a stream for a while."""
    history = JointHistory()
    history.add(time.monotonic(), HEAD.rest(), HEAD.rest())
    try:
        with closing(forged_streams.Server(script)) as server:
            eye = EyeThread(
                camera_config(source=server.url), HEAD, HeadSearch(TAG, HEAD).eyes[0], history
            )
            try:
                eye.start()
                until_s = time.monotonic() + _STREAM_S
                while time.monotonic() < until_s:
                    eye.check()
                    eye.take_searched_images()
                    time.sleep(0.01)
                return "images" if eye.ready else "no image yet"
            finally:
                eye.close()
                if eye.is_alive():
                    time.sleep(3.0)
    except VergenceError as error:
        said = str(error)
        known = ("the stream ended", "expected images", "expected a video")
        if said.isprintable() and any(one in said for one in known):
            return type(error).__name__
        return f"FAULT {said!r}"
    except BaseException:
        return f"FAULT {traceback.format_exc()}"


def main(words: list[str], folder: Path) -> Findings:
    """Fuzz."""
    options = options_of(
        __doc__ or "",
        words,
        minutes=5.0,
        seed=time.time_ns() % 10**6,
        only=("config", "log", "stream", "line"),
    )
    print(f"seed {options.seed}", flush=True)
    os.chdir(folder)
    inputs = Inputs(folder)
    with suppress(FaultError):  # compile the kernels outside of any limit
        inputs.log(((), "state-feedback"))
    for name in options.only:
        cases, attempt = inputs.attempts()[name]
        inputs.found.ends.clear()
        for number in rounds(options.minutes, options.seed):
            try_each(
                cases, partial(inputs.judge, name, attempt), number, 4 if name == "stream" else 25
            )
        inputs.found.show(f"{name} in {options.minutes:g} minutes")
    return inputs.found

"""How fast an emulated head comes to rest after each fault, at drawn moments of its motion.

Run ``python benchmarks/faults.py``, with ``--csv docs/results/faults.csv`` to keep the table and
``--only "lost answers" unplug`` for some of it. At each moment a trial begins, the joints turn for
ever by drawn sinusoids, and the fault begins at a drawn time. The emulated head's own record says
after how long all joints turned by less than a step of the servos' speed, 0.024 rad/s. A moment is
within its bound if they did in time and the reason was that of the fault; the exit status is 1 if
one is not. A moment that takes more than 30 s ends it all, with the stacks of all threads.

With V, A, lag, T and W the head's greatest speed and acceleration, lag, control period and the
servos' watchdog, braking takes at most REST = V / A + 5 lag + 3 T. See ``docs/robot.md``.
"""

import argparse
import dataclasses
import faulthandler
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import pandas as pd
import psutil
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.wire import emulated
from vergence.envs.rollout import rollout
from vergence.envs.task import GazeTask
from vergence.errors import ConfigurationError, VergenceWarning
from vergence.hardware.config import HardwareConfig, load_hardware
from vergence.hardware.dynamixel import control_table as table
from vergence.hardware.dynamixel.bus import Bus
from vergence.hardware.emulator.client import EmulatedWorld
from vergence.models.head import HeadModel
from vergence.models.joints import EYE_NAMES, EYES
from vergence.models.parts import FloatArray

Reaction = Literal["stops", "goes on", "either"]

MOMENT_S: Final = 30.0
"""Longest time of one moment, s."""
GOES_ON_S: Final = 1.5
"""Time for which a fault that need not stop is watched, s."""
SETTLED_S: Final = 0.3
"""Time after the bound for which the joints have to stay at rest, s."""
LEAST_RAD_S: Final = 0.3
"""Speed of the fastest joint below which a moment proves nothing, rad/s."""
GAZES_RAD_S: Final = 1.0
"""Speed that a gaze at a target aside exceeds, and no joint that is proved or begins at rest."""
LOST_S: Final = 60.0
"""In place of the configuration's: the joints turn though the target is out of view."""
RATES_HZ: Final = (0.5, 1.2)
SLOW_RATES_HZ: Final = (0.5, 0.9)
"""Of faults that last: at 1 Hz joints swing eight times in 4 s, for which they are stopped too."""
PEAKS_RAD_S: Final = (1.5, 3.0)
PULL: Final = 0.5
"""Gain by which joints tend to straight ahead, away from their limits, 1/s."""
ENDS_S: Final = 10.0
"""Longest time from a signal to the end of the process, s."""


class Found(NamedTuple):
    """What came of one moment."""

    rested_s: float
    """From the fault's beginning until all joints rested, s; inf if they did not, nan if a head
    that went on was not asked."""
    fastest: float
    """Speed of the fastest joint since the beginning, rad/s."""
    message: str
    """Reason of the stop; empty for none."""
    wrong: str = ""
    """Anything wrong but for the bound, in words."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One fault: what begins it, and what has to come of it."""

    bound_s: float
    """Longest time from its beginning to rest, s."""
    reason: str = ""
    """Words of the reason."""
    reaction: Reaction = "stops"
    request: dict[str, Any] | None = None
    """A fault of the emulated head; None for one that `play` begins."""
    whom: Literal["", "servo", "eye"] = ""
    """One servo or one eye, drawn, that it befalls; all if empty."""
    play: "Callable[[Desk, Draw, float], Found] | None" = None
    """Plays a fault of the policy or of its process, with the bound."""
    rates_hz: tuple[float, float] = RATES_HZ
    for_good: bool = False
    """Whether the head has to be started anew."""
    latches: bool = False
    """Whether servos have an error that a reboot alone ends."""
    lets_go: bool = False
    """Whether the servo that it befalls has to be without torque afterwards."""


class Draw:
    """What is drawn for one moment."""

    def __init__(self, seed: int, case: str, moment: int, rates_hz: tuple[float, float]) -> None:
        self.rng = np.random.default_rng((seed, *case.encode(), moment))
        self.trial = (seed, moment)
        self.after_s = float(self.rng.uniform(0.3, 1.5))
        self.servo, self.eye = int(self.rng.integers(4)), str(self.rng.choice(EYE_NAMES))
        # a great and a small sinusoid: the joint seldom rests
        shares = np.array([[0.8], [0.2]])
        self.peaks = shares * self.rng.uniform(*PEAKS_RAD_S, 4)
        self.rates = 2.0 * np.pi * self.rng.uniform(*rates_hz, (2, 4))
        self.phases = self.rng.uniform(0.0, 2.0 * np.pi, (2, 4))

    def speeds(self, time_s: float) -> FloatArray:
        """(4,) velocities at a time, rad/s."""
        return np.asarray((self.peaks * np.sin(self.rates * time_s + self.phases)).sum(axis=0))


class Mover:
    """A policy that turns all joints for ever.

    Args:
        task: tells the joints' angles.
        draw: their motion.
        due: called with the time since the trial's start, s, and the action, before each step.
    """

    def __init__(
        self,
        task: GazeTask,
        draw: Draw,
        due: Callable[[float, NDArray[Any]], None] = lambda _time_s, _action: None,
    ) -> None:
        self._task, self._draw, self._due = task, draw, due
        self._middle = task.head.rest()[EYES]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        reading = self._task.reading
        time_s = float(reading.time_s[0])
        wish = self._draw.speeds(time_s) + PULL * (self._middle - reading.positions[0, EYES])
        action = np.nan_to_num(wish / self._task.layout.action_limits)[None]
        self._due(time_s, action)
        return action, state


class Desk:
    """An emulated head and a task on it."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self.start()

    def start(self) -> None:
        """Start a head, in place of the one before."""
        self.close()
        self._open = ExitStack()
        self.config = patient(self._open.enter_context(emulated()))
        self.head = self.config.head
        self.world = EmulatedWorld(self.config.emulator)
        self._open.callback(self.world.close)
        self.task = task_of(self.config)
        self._open.callback(self.task.close)

    def close(self) -> None:
        """End the head."""
        self._open.close()

    def heal(self, case: Case) -> None:
        """End the fault and what it has left behind, and let the head be opened anew."""
        self.task.plant.release()
        self.world.clear()
        if case.latches:
            self.world.fault(what="reboot")
        time.sleep(0.2)  # a stream is open again with its next frame

    def rested(self, since_s: float, bound_s: float) -> tuple[float, float]:
        """After how long all joints rested, inf if they still turn, s; and the fastest's speed."""
        while True:
            past_s = time.monotonic() - since_s - bound_s
            told = self.world.ask({"rest": {"since": since_s}})
            if past_s > SETTLED_S and (told["rested_s"] is not None or past_s > 2.0):
                break
            time.sleep(0.02)
        rested_s = np.inf if told["rested_s"] is None else told["rested_s"] - since_s
        return float(rested_s), float(told["fastest"])

    def has_torque(self, ident: int) -> bool:
        """Whether a servo holds, while nobody else has the line."""
        bus = Bus(self.config.bus.port, self.config.bus.baud_rate)
        try:
            return bool(bus.read(ident, table.TORQUE_ENABLE))
        finally:
            bus.close()


def patient(config: HardwareConfig) -> HardwareConfig:
    """A configuration under which the joints turn though the target is out of view."""
    return dataclasses.replace(config, safety=dataclasses.replace(config.safety, lost_s=LOST_S))


def task_of(config: HardwareConfig) -> GazeTask:
    """A task at drawn targets from drawn starts."""
    options = {"config": config}
    return GazeTask(1, head=config.head, plant="hardware", target="random", plant_options=options)


def begin(task: GazeTask, draw: Draw, policy: Mover) -> None:
    """Begin a trial."""
    seed, moment = draw.trial
    task.prepare(policy)
    task.begin(np.zeros(1, np.int64), np.full(1, seed, np.uint64), np.full(1, moment, np.uint64))


def step(task: GazeTask, policy: Mover) -> None:
    """One period."""
    action, _ = policy.predict(task.observation.copy())
    task.step(task.as_action(action))


# ---- faults of the emulated head ----


def befall(desk: Desk, case: Case, draw: Draw) -> Found:
    """Have a fault of the emulated head at a drawn time, and go on until it stops or need not."""
    request = dict(case.request or {})
    ident = desk.config.servos[draw.servo].id
    if case.whom:
        request |= {"ids": [ident]} if case.whom == "servo" else {"eye": draw.eye}
    task, policy = desk.task, Mover(desk.task, draw)
    begin(task, draw, policy)
    with ThreadPoolExecutor(1) as pool:
        # at any time within a period, not at its end as this thread could
        due = pool.submit(_at, time.monotonic() + draw.after_s, desk.world, request)
        while not task.plant.fault and not _is_over(due, case):
            step(task, policy)
        stopped_s = time.monotonic()
        begun_s = due.result()
    message = task.plant.fault
    if message and stopped_s < begun_s:
        return Found(np.nan, np.nan, message, "stopped before the fault")
    if not message:
        fastest = float(desk.world.ask({"rest": {"since": begun_s}})["fastest"])
        stops = case.reaction == "stops"
        return Found(np.inf if stops else np.nan, fastest, "", "went on" if stops else "")
    rested_s, fastest = desk.rested(begun_s, case.bound_s)
    task.plant.release()
    wrong = ""
    if case.lets_go and desk.has_torque(ident):
        wrong = "the servo still has torque"
    return Found(rested_s, fastest, message, wrong)


def _at(due_s: float, world: EmulatedWorld, request: dict[str, Any]) -> float:
    time.sleep(max(due_s - time.monotonic(), 0.0))
    return world.fault(**request)


def _is_over(due: "Future[float]", case: Case) -> bool:
    """Whether no reaction has to be waited for any more."""
    if not due.done():
        return False
    watched_s = case.bound_s + 2.0 if case.reaction == "stops" else GOES_ON_S
    return time.monotonic() > due.result() + watched_s


# ---- faults of the policy ----


def not_a_number(desk: Desk, draw: Draw, bound_s: float) -> Found:
    """A policy whose answer is nan."""
    begun: list[float] = []

    def due(time_s: float, action: NDArray[Any]) -> None:
        if time_s >= draw.after_s:
            begun.append(time.monotonic())
            action[0, draw.servo] = np.nan

    policy = Mover(desk.task, draw, due)
    begin(desk.task, draw, policy)
    wrong = "the action was taken"
    try:
        while not desk.task.plant.fault and len(begun) < 2:
            step(desk.task, policy)
    except ConfigurationError:
        wrong = ""
    return _told(desk, begun, bound_s, desk.task.plant.fault, wrong)


def sleeps(desk: Desk, draw: Draw, bound_s: float) -> Found:
    """A policy that takes a second once."""
    begun: list[float] = []

    def due(time_s: float, _action: NDArray[Any]) -> None:
        if time_s >= draw.after_s and not begun:
            begun.append(time.monotonic())
            time.sleep(1.0)

    policy = Mover(desk.task, draw, due)
    begin(desk.task, draw, policy)
    while not desk.task.plant.fault and not begun:
        step(desk.task, policy)
    wrong = "" if desk.task.plant.fault else "the next step had no fault"
    return _told(desk, begun, bound_s, desk.task.plant.fault, wrong)


def raises(desk: Desk, draw: Draw, bound_s: float) -> Found:
    """A policy that raises an exception within a rollout, which has to pass it on."""
    begun: list[float] = []

    def due(time_s: float, _action: NDArray[Any]) -> None:
        if time_s >= draw.after_s:
            begun.append(time.monotonic())
            raise _PolicyError("a policy's own error")

    seed, moment = draw.trial
    message, wrong = "", "the exception was lost"
    try:
        policy = Mover(desk.task, draw, due)
        rollout(desk.task, policy, 600, lambda _step: None, seed=seed, first_trial=moment)
    except _PolicyError as error:
        message, wrong = str(error), ""
    return _told(desk, begun, bound_s, message, wrong)


class _PolicyError(Exception):
    """A policy's own."""


def _told(desk: Desk, begun: list[float], bound_s: float, message: str, wrong: str) -> Found:
    if not begun:
        return Found(np.nan, np.nan, message, "stopped before the fault")
    return Found(*desk.rested(begun[0], bound_s), message, wrong)


# ---- faults of the process ----


def turn(path: Path, draw: Draw) -> None:
    """Turn the joints for ever: what is killed."""
    task = task_of(patient(load_hardware(path)))
    policy = Mover(task, draw)
    begin(task, draw, policy)
    step(task, policy)
    print("turning", flush=True)
    while not task.plant.fault:
        step(task, policy)
    print(task.plant.fault, flush=True)


def signalled(name: str) -> Callable[[Desk, Draw, float], Found]:
    """A process that gets a signal which it cannot handle."""

    def play(desk: Desk, draw: Draw, bound_s: float) -> Found:
        seed, moment = draw.trial
        words = [sys.executable, __file__, "--turn", desk.config.path]
        words += [str(seed), name, str(moment)]
        with _process(words) as process:
            assert process.stdout is not None
            line = process.stdout.readline().strip()
            if line != "turning":
                return Found(np.nan, np.nan, line, "did not begin to turn")
            time.sleep(draw.after_s)
            begun_s = time.monotonic()
            process.send_signal(getattr(signal, name))
            found = Found(*desk.rested(begun_s, bound_s), name)
            process.kill()
            said = process.stdout.read().strip()
        return found._replace(wrong=said)

    return play


def interrupted(name: str) -> Callable[[Desk, Draw, float], Found]:
    """`vergence gaze` that is asked to end."""

    def play(desk: Desk, draw: Draw, bound_s: float) -> Found:
        with tempfile.TemporaryDirectory() as folder:
            words = [sys.executable, "-m", "vergence", "gaze", "--plant", "hardware"]
            words += ["--config", desk.config.path, "--controller", "state-feedback"]
            words += ["--duration", "30", "--out", str(Path(folder) / "run")]
            words += ["--target", "250", "-150", "800"]
            with _process(words, stderr=subprocess.STDOUT) as process:
                # while it proves the joints, or not before it gazes
                least = float(draw.rng.choice([LEAST_RAD_S, GAZES_RAD_S]))
                while np.abs(desk.world.ask({"state": None})["velocities"]).max() < least:
                    if process.poll() is not None:
                        assert process.stdout is not None
                        said = process.stdout.read().strip()
                        return Found(np.nan, np.nan, said, "ended before joints moved")
                    time.sleep(0.005)
                time.sleep(float(draw.rng.uniform(0.0, 0.05)))
                begun_s = time.monotonic()
                process.send_signal(getattr(signal, name))
                found = Found(*desk.rested(begun_s, bound_s), "")
                try:
                    said, _ = process.communicate(timeout=begun_s + ENDS_S - time.monotonic())
                except subprocess.TimeoutExpired:
                    return found._replace(wrong=f"runs {ENDS_S:g} s after {name}")
        wrong = "" if process.returncode == 130 else f"ended with status {process.returncode}"
        return found._replace(message=f"{name}: {said.strip()}", wrong=wrong)

    return play


@contextmanager
def _process(words: list[str], stderr: int = subprocess.DEVNULL) -> "Iterator[Any]":
    """A process that does not outlive the block."""
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=stderr, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


# ---- the table ----


def cases(head: HeadModel, config: HardwareConfig) -> dict[str, Case]:
    """All faults by name."""
    timing, actuation = head.timing, head.actuation
    period_s, lags_s = timing.period_s, 5.0 * timing.lag_s
    speed, acceleration = actuation.velocity[EYES].max(), actuation.acceleration[EYES].min()
    rest_s = float(speed / acceleration) + lags_s + 3.0 * period_s
    silent_s = 0.1 + 2.0 * period_s + rest_s
    alone_s = config.bus.watchdog_s + lags_s + 0.02
    image_s = config.safety.image_age_s + 0.3 + rest_s
    follows_s = 0.8 + rest_s
    no_answer, no_image = "expected an answer of the id", "expected a new image"
    follow = "expected the joint to follow"

    def on_line(what: str, **more: Any) -> Case:
        return Case(bound_s=silent_s, reason=no_answer, request={"what": what}, **more)

    def of_servo(what: str, bound_s: float, reason: str, **more: Any) -> Case:
        return Case(bound_s=bound_s, reason=reason, request={"what": what}, whom="servo", **more)

    def of_eye(what: str, **values: Any) -> Case:
        request = {"what": what, **values}
        return Case(bound_s=image_s, reason=no_image, request=request, whom="eye")

    def on_signal(name: str) -> Case:
        return Case(bound_s=alone_s, play=signalled(name))

    return {
        "lost answers": on_line("lost"),
        "bad-crc": on_line("bad-crc"),
        "short": on_line("short"),
        "late": on_line("late"),
        "lost answers of one": on_line("lost", whom="servo"),
        "silent servo": of_servo("silent", max(silent_s, alone_s), no_answer),
        "half lost for 1 s": Case(
            bound_s=1.0 + silent_s,
            reaction="either",
            request={"what": "lost", "probability": 0.5, "for_s": 1.0},
        ),
        "doubled": Case(bound_s=0.0, reaction="goes on", request={"what": "doubled"}),
        "unplug": Case(bound_s=alone_s, reason="gone", request={"what": "unplug"}, for_good=True),
        "overload": of_servo("overload", 2.0 * period_s + rest_s, "overload", latches=True),
        "reboot": of_servo("reboot", 12.0 * period_s + rest_s, "let go"),
        "voltage": Case(
            bound_s=1.0 + rest_s,
            reason="voltage",
            request={"what": "voltage", "value": 4.0},
            latches=True,
        ),
        "temperature": dataclasses.replace(
            of_servo("temperature", 1.0 + 2.0 * period_s + rest_s, "temperature", lets_go=True),
            # 3 K below the emulated servos' limit
            request={"what": "temperature", "value": 69.0},
        ),
        "load": dataclasses.replace(
            of_servo("load", 4.0 + rest_s, "load", rates_hz=SLOW_RATES_HZ),
            request={"what": "load", "value": 100.0},
        ),
        "encoder frozen": of_servo("frozen", follows_s, follow),
        "joint stuck": of_servo("stuck", follows_s, follow),
        "wrong-way": of_servo("wrong-way", follows_s, follow),
        "camera ended": Case(
            bound_s=0.5 + rest_s, reason="cameras.", request={"what": "ended"}, whom="eye"
        ),
        "camera stalled": of_eye("stalled"),
        "camera frozen": of_eye("frozen"),
        "camera dropped": of_eye("dropped", probability=1.0),
        "camera late by 1 s": of_eye("late", value=1.0),
        "camera torn": Case(
            bound_s=GOES_ON_S + rest_s, reaction="either", request={"what": "torn"}, whom="eye"
        ),
        "cameras out of step": Case(
            bound_s=0.0, reaction="goes on", request={"what": "out-of-step"}
        ),
        "policy nan": Case(bound_s=period_s + rest_s, reason="nan", play=not_a_number),
        "policy raises": Case(bound_s=2.0 * period_s + lags_s + 0.05, play=raises),
        "policy sleeps 1 s": Case(bound_s=alone_s, reason="of silence", play=sleeps),
        "SIGKILL": on_signal("SIGKILL"),
        "SIGSTOP": on_signal("SIGSTOP"),
        "gaze SIGINT": Case(bound_s=0.5, play=interrupted("SIGINT")),
        "gaze SIGTERM": Case(bound_s=0.5, play=interrupted("SIGTERM")),
    }


def judged(case: Case, found: Found) -> Found:
    """What came of a moment, with all that is wrong with it but for the bound."""
    if found.wrong:
        return found
    if case.reaction == "goes on" and found.message:
        return found._replace(wrong="stopped")
    if case.reaction == "stops" and case.reason not in found.message:
        return found._replace(wrong=f"the reason has no {case.reason!r}")
    if not found.fastest > LEAST_RAD_S:
        return found._replace(wrong="the joints did not turn")
    return found


def within(case: Case, found: Found) -> bool:
    """Whether a moment is as it has to be."""
    late = found.rested_s > case.bound_s if found.message else case.reaction == "stops"
    return not found.wrong and not late


@contextmanager
def limited(name: str, moment: int) -> Iterator[None]:
    """End everything, with the stacks of all threads, if the block hangs."""

    def hang() -> None:
        sys.stderr.write(f"\n{name}, moment {moment}: hangs for {MOMENT_S:g} s\n")
        faulthandler.dump_traceback(all_threads=True)
        for child in psutil.Process().children(recursive=True):
            child.kill()
        os._exit(1)

    timer = threading.Timer(MOMENT_S, hang)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def measure(names: list[str] | None, moments: int, seed: int) -> Any:
    """A row a moment."""
    desk, rows = Desk(), []
    try:
        known = cases(desk.head, desk.config)
        names = names or list(known)
        if unknown := [name for name in names if name not in known]:
            raise SystemExit(f"--only: expected some of {', '.join(known)}, got {unknown[0]}")
        # compiles all
        desk.task.prepare(Mover(desk.task, Draw(seed, "", 0, RATES_HZ)))
        desk.task.plant.release()
        jobs = [(name, moment) for name in names for moment in range(moments)]
        for name, moment in track(jobs, "faults", console=Console(stderr=True)):
            case = known[name]
            draw = Draw(seed, name, moment, case.rates_hz)
            with limited(name, moment):
                sound = not case.for_good
                try:
                    found = (
                        befall(desk, case, draw)
                        if case.play is None
                        else case.play(desk, draw, case.bound_s)
                    )
                    if sound:
                        desk.heal(case)
                except Exception as error:
                    # told as what came of the moment; the next one has a head of its own
                    words = f"{type(error).__name__}: {error}"
                    found, sound = Found(np.inf, np.nan, words, "raised"), False
                found = judged(case, found)
            rows.append(
                {
                    "fault": name,
                    "reaction": case.reaction,
                    "moment": moment,
                    "bound_s": case.bound_s if case.reaction != "goes on" else np.nan,
                    "within": within(case, found),
                    **found._asdict(),
                }
            )
            if not sound:
                desk.start()
    finally:
        desk.close()
    return pd.DataFrame(rows)


def summary(found: Any) -> Any:
    """A row a fault; the message is that of the worst moment."""
    rows = []
    for name, group in found.groupby("fault", sort=False):
        rested_s = group.rested_s.dropna()
        order = group.sort_values(["within", "rested_s"], ascending=[True, False])
        worst = order.iloc[0]
        rows.append(
            {
                "fault": name,
                "reaction": worst.reaction,
                "moments": len(group),
                "stopped": int((group.message != "").sum()),
                "worst_ms": 1e3 * rested_s.max() if len(rested_s) else np.nan,
                "median_ms": 1e3 * rested_s.median() if len(rested_s) else np.nan,
                "bound_ms": 1e3 * worst.bound_s,
                "within": int(group.within.sum()),
                "message": ": ".join(filter(None, (worst.wrong, " ".join(worst.message.split())))),
            }
        )
    return pd.DataFrame(rows)


def show(rows: Any) -> None:
    """Print a table."""
    out = Table()
    for name in rows.columns:
        words = name in ("fault", "reaction", "message")
        out.add_column(
            name.replace("_", " "),
            justify="left" if words else "right",
            no_wrap=name != "message",
            overflow="fold",
        )
    for row in rows.itertuples(index=False):
        cells = (
            "-" if one != one else f"{one:.0f}" if isinstance(one, float) else one for one in row
        )
        out.add_row(*map(str, cells))
    Console(width=190).print(out)


def main() -> int:
    """Measure and print; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="NAME")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--turn", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    warnings.simplefilter("ignore", VergenceWarning)
    if options.turn:
        config, seed, case, moment = options.turn
        turn(Path(config), Draw(int(seed), case, int(moment), RATES_HZ))
        return 0
    # a shell starts what is in its background without SIGINT, and processes inherit that
    signal.signal(signal.SIGINT, signal.default_int_handler)
    found = measure(options.only, options.moments, options.seed)
    rows = summary(found)
    show(rows)
    if options.csv:
        rows.to_csv(options.csv, index=False, float_format="%.6g")
    return int(not found.within.all())


if __name__ == "__main__":
    sys.exit(main())

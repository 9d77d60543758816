"""All checks of a robot before it moves: its servos, its posture and its cameras."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np

from vergence.errors import ChecksFailedError, ConfigurationError, Finding, HardwareError
from vergence.hardware.config import HardwareConfig
from vergence.hardware.emulator.client import WorldClient
from vergence.hardware.servos import JointAngles, ServoReading, Servos
from vergence.vision.image import (
    EXPOSURE_STEP_S,
    MANUAL_EXPOSURE,
    is_local_camera,
    open_capture,
    suppress_opencv_log,
)

FIRST_IMAGE_TIMEOUT_S: Final = 5.0
"""Longest wait for the first image, s (chosen)."""
_MIN_RATE_RATIO: Final = 0.8
"""Least measured frame rate as a fraction of the requested one (chosen)."""
_WARM_UP_S: Final = 0.5
"""Time after the first image in which buffers empty and the exposure settles, s (chosen)."""
_MEASURED_S: Final = 1.0
"""Duration of the measurement of a frame rate, s (chosen)."""

CaptureDevice = Any  # a `cv2.VideoCapture`, or what stands for one


@dataclass(frozen=True, kw_only=True)
class CameraRequest:
    """One camera and the settings requested from it."""

    name: str  # name in messages
    source: str  # camera number, device file or URL
    size: tuple[int, int] | None = None  # (width, height), px; None for the camera's own
    frame_rate_hz: float | None = None  # frame rate, Hz; None for the camera's own
    pixel_format: str = ""  # pixel format, four letters; empty for the camera's own
    exposure_s: float | None = None  # exposure time to lock, s; None leaves the setting


@dataclass(frozen=True, kw_only=True)
class CameraState:
    """Actual settings and frame rate of a camera, as far as they are known."""

    request: CameraRequest  # requested settings
    size: tuple[int, int] | None  # (width, height) of its images, px; None if none arrived
    rate_hz: float  # frame rate measured while all cameras gave images, Hz
    pixel_format: str = ""  # pixel format that it reports
    reported_hz: float = np.nan  # frame rate that it reports, Hz
    alone_hz: float = np.nan  # frame rate measured while the others were closed, Hz
    exposure_locked: bool | None = None  # true if its exposure is locked; None if unknown
    exposure_s: float = np.nan  # exposure time that it reports, s

    @property
    def too_slow(self) -> bool:
        """True if the frame rate was well below the requested one, or no images arrived."""
        return self.rate_hz < _MIN_RATE_RATIO * (self.request.frame_rate_hz or 1e-9)

    @property
    def slowed_by_others(self) -> bool:
        """True if it was too slow, but fast enough while the others were closed."""
        least_hz = _MIN_RATE_RATIO * (self.request.frame_rate_hz or 0.0)
        return self.too_slow and self.alone_hz >= least_hz


def camera_requests(config: HardwareConfig) -> tuple[CameraRequest, ...]:
    """Requests for a robot's cameras."""
    sizes = config.head.cameras.size.tolist()
    return tuple(
        CameraRequest(
            name=camera.name,
            source=camera.source,
            size=(sizes[camera.eye][0], sizes[camera.eye][1]),
            frame_rate_hz=config.head.timing.frame_rate_hz,
            pixel_format=camera.pixel_format,
            exposure_s=camera.exposure_s,
        )
        for camera in config.cameras
    )


def _open(request: CameraRequest, open: Callable[..., CaptureDevice]) -> CaptureDevice:
    asked = dict(vars(request))
    return open(asked.pop("source"), asked.pop("name"), **asked)


def _watch(
    capture: CaptureDevice, clock: Callable[[], float]
) -> tuple[tuple[int, int] | None, float]:
    """Size of the images, and frame rate, of a camera."""
    begun_s = clock()
    until_s = begun_s + FIRST_IMAGE_TIMEOUT_S
    times: list[float] = []
    size = None
    while clock() < until_s and capture.grab():
        times.append(clock())
        if size is None:
            there, image = capture.retrieve()
            size = (int(image.shape[1]), int(image.shape[0])) if there else None
        if len(times) == 1:
            until_s = times[0] + _WARM_UP_S + _MEASURED_S
    if not times:
        return None, 0.0
    counted = [time_s for time_s in times if time_s - times[0] >= _WARM_UP_S]
    if len(counted) < 2:
        return size, len(times) / (_WARM_UP_S + _MEASURED_S)
    return size, (len(counted) - 1) / (counted[-1] - counted[0])


def _state(
    request: CameraRequest, capture: CaptureDevice, size: tuple[int, int] | None, rate_hz: float
) -> CameraState:
    state = CameraState(request=request, size=size, rate_hz=rate_hz)
    if not is_local_camera(request.source):  # a stream's settings are those of its server
        return state
    mode = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    steps = capture.get(cv2.CAP_PROP_EXPOSURE)
    letters = int(capture.get(cv2.CAP_PROP_FOURCC))
    set_hz = capture.get(cv2.CAP_PROP_FPS)
    return replace(
        state,
        pixel_format=letters.to_bytes(4, "little").decode("latin-1") if letters > 0 else "",
        reported_hz=set_hz if set_hz > 0.0 else np.nan,
        exposure_locked=mode == MANUAL_EXPOSURE if mode >= 0.0 else None,
        exposure_s=EXPOSURE_STEP_S * steps if steps > 0.0 else np.nan,
    )


def _rate_alone(
    state: CameraState, open: Callable[..., CaptureDevice], clock: Callable[[], float]
) -> CameraState:
    """Complete a slow camera's state by its rate while the others are closed."""
    try:
        capture = _open(state.request, open)
    except ConfigurationError:  # it has been removed meanwhile
        return state
    try:
        size, alone_hz = _watch(capture, clock)
    finally:
        capture.release()
    return replace(state, size=state.size or size, alone_hz=alone_hz)


_EXPOSURE_TOLERANCE: Final = 0.2
"""Tolerance of the exposure as a fraction of the requested one: cameras have coarse steps
(chosen)."""
_RATE_TOLERANCE: Final = 0.01
"""Tolerance of the reported frame rate as a fraction of the requested one: 30 may be 29.97
(chosen)."""


def check_cameras(
    requests: Sequence[CameraRequest],
    *,
    open: Callable[..., CaptureDevice] = open_capture,
    clock: Callable[[], float] = time.monotonic,
) -> tuple[list[CameraState], list[Finding]]:
    """Open cameras, all at once, measure their rates, and find all problems.

    Returns the states of the cameras that could be opened, and the findings of all.
    """
    findings: list[Finding] = []
    captures: list[tuple[CameraRequest, CaptureDevice]] = []
    with suppress_opencv_log(), ExitStack() as opened:
        for request in requests:
            try:
                capture = _open(request, open)
            except ConfigurationError as error:
                findings.append(_unopened(request, str(error).removeprefix(f"{request.name}: ")))
                continue
            opened.callback(capture.release)
            captures.append((request, capture))
        with ThreadPoolExecutor(max(len(captures), 1)) as pool:
            watched = list(pool.map(lambda one: _watch(one[1], clock), captures))
        states = [
            _state(request, capture, *seen)
            for (request, capture), seen in zip(captures, watched, strict=True)
        ]
        opened.close()  # so that slow cameras can be opened alone
        if len(states) > 1:
            states = [
                _rate_alone(state, open, clock) if state.too_slow else state for state in states
            ]
    for state in states:
        findings += _judge(state)
    shared = [state for state in states if state.slowed_by_others]
    return states, [*findings, _bandwidth(shared)] if shared else findings


def check_local_cameras(config: HardwareConfig) -> list[Finding]:
    """Find all problems of a robot's cameras but streams, which are checked while they run."""
    requests = [one for one in camera_requests(config) if is_local_camera(one.source)]
    return check_cameras(requests)[1] if requests else []


def _unopened(request: CameraRequest, problem: str) -> Finding:
    if not is_local_camera(request.source):
        cure = "start its server, and try the address in a browser"
    elif "no such device" in problem:
        cure = "plug it in, or name another; names in /dev/v4l/by-id stay the same"
    else:
        # the message of a missing permission has its cure
        cure = "" if "permission" in problem else "end the other program"
    return Finding(part=request.name, problem=problem, cure=cure)


def _judge(state: CameraState) -> Iterator[Finding]:
    """Findings of one camera by itself."""
    request = state.request
    listed = "one that v4l2-ctl --list-formats-ext lists"
    size_cure = listed if is_local_camera(request.source) else "another size at its server"
    if state.size is not None and request.size not in (None, state.size):
        yield Finding(
            part=request.name,
            problem=f"expected images of {_size(request.size)}, as the head has them, got "
            f"{_size(state.size)}",
            cure=f"{size_cure}, and calibrate the head with such a size",
        )
    if state.pixel_format and request.pixel_format not in ("", state.pixel_format):
        yield Finding(
            part=request.name,
            problem=f"expected the pixel format {request.pixel_format}, got {state.pixel_format}",
            cure=listed,
            warning=True,
        )
    if not state.slowed_by_others:
        yield from _judge_rate(state)
    yield from _judge_exposure(state)


def _judge_rate(state: CameraState) -> Iterator[Finding]:
    asked_hz, source = state.request.frame_rate_hz, state.request.source
    local = is_local_camera(source)
    place = f"the camera {source}" if local else source
    if not state.rate_hz:
        yield Finding(
            part=state.request.name,
            problem=f"expected images from {place}, got none within {FIRST_IMAGE_TIMEOUT_S:g} s",
            cure="another cable, port or camera; does another program use it?"
            if local
            else "check its server and the network",
        )
    elif asked_hz is not None and state.too_slow:
        cure = 'pixel_format = "MJPG"' if local else "more light, a stream of fewer bytes"
        if local and not state.exposure_locked:
            cure = f"a locked exposure_s below {1.0 / asked_hz:.3g}, more light, {cure}"
        yield Finding(
            part=state.request.name,
            problem=f"expected {asked_hz:g} images a second, got {state.rate_hz:.3g}",
            cure=f"{cure}, or a lower frame_rate_hz in the head file",
        )
    elif asked_hz is not None and abs(state.reported_hz - asked_hz) > _RATE_TOLERANCE * asked_hz:
        yield Finding(
            part=state.request.name,
            problem=f"expected the setting of {asked_hz:g} images a second to be kept, got "
            f"{state.reported_hz:g}",
            cure="a frame_rate_hz in the head file that the camera has, see "
            "v4l2-ctl --list-formats-ext",
            warning=True,
        )


def _judge_exposure(state: CameraState) -> Iterator[Finding]:
    request, asked_s = state.request, state.request.exposure_s
    if asked_s is not None and is_local_camera(request.source):
        apart = abs(state.exposure_s - asked_s)
        kept = apart <= _EXPOSURE_TOLERANCE * asked_s or np.isnan(apart)
        if not state.exposure_locked or not kept:
            how = {True: "locked", False: "automatic", None: "unknown"}[state.exposure_locked]
            yield Finding(
                part=request.name,
                problem=f"expected an exposure locked to {asked_s:g} s, got {how}"
                + ("" if np.isnan(state.exposure_s) else f", {state.exposure_s:g} s"),
                cure="an exposure_s that the camera has, see v4l2-ctl --list-ctrls",
                warning=True,
            )
    elif state.exposure_locked is False:
        yield Finding(
            part=request.name,
            problem="expected a locked exposure, got an automatic one: rate and latency change "
            "with the light",
            cure=f"exposure_s = 0.008 in [{request.name}], or as long as the light asks for",
            warning=True,
        )


def _bandwidth(shared: Sequence[CameraState]) -> Finding:
    """Finding of cameras that are fast enough alone, but not together."""
    rates = "; ".join(
        f"{state.request.name} {state.rate_hz:.3g} ({state.alone_hz:.3g} alone)" for state in shared
    )
    full, cure = "USB controller", 'pixel_format = "MJPG", a port of another USB controller'
    if not all(is_local_camera(state.request.source) for state in shared):
        full, cure = "network or machine", "a stream of fewer bytes"
    return Finding(
        part="cameras",
        problem=f"expected {shared[0].request.frame_rate_hz:g} images a second of all at once, got "
        f"{rates}: the {full} that they share is full",
        cure=f"{cure}, or a smaller size",
    )


def _size(size: tuple[int, int] | None) -> str:
    return "unknown size" if size is None else f"{size[0]} x {size[1]}"


_JOINT_LIMIT_TOLERANCE_RAD: Final = 0.02
"""Tolerance of a joint's limits, rad, for sagging and backlash of the gears (chosen)."""


@dataclass(frozen=True, kw_only=True)
class CheckedPart:
    """One part of a robot, its description, empty if nothing is known, and its problems."""

    name: str
    description: str
    findings: tuple[Finding, ...]

    @property
    def ready(self) -> bool:
        """True if the robot may move with it."""
        return all(finding.warning for finding in self.findings)


def raise_errors(findings: Iterable[Finding]) -> list[Finding]:
    """Raise an error if a finding is one; return the warnings otherwise."""
    findings = list(findings)
    if not all(finding.warning for finding in findings):
        raise ChecksFailedError(findings)
    return findings


def check_servos(
    config: HardwareConfig, servos: Servos, *, check_joint_in_limits: bool = True
) -> list[Finding]:
    """Find all problems of open servos before they get torque. Nothing is written to them.

    Joints are not checked to be within their limits while zeros are being set.
    """
    findings = servos.check()
    if servos.stops_alone_after_s is None:
        findings.append(
            Finding(
                part="bus",
                problem="expected servos that stop by themselves when nobody speaks, got ones that "
                "nothing stops: if this process dies, they turn on",
                cure="keep a switch of their power at hand",
                warning=True,
            )
        )
    begun_s, period_s = servos.clock(), config.head.timing.period_s
    reading = servos.read()
    taken_s = servos.clock() - begun_s
    if taken_s > period_s:
        problem = (
            f"within the control period of {1e3 * period_s:.3g} ms, got {1e3 * taken_s:.3g} ms"
        )
        cure = "a faster line, or a lower control_rate_hz in the head file"
        problem = f"expected a reading of all servos {problem}"
        findings.append(Finding(part="bus", problem=problem, cure=cure))
    if check_joint_in_limits:
        findings += _posture(config, servos, reading)
    return findings


def _posture(config: HardwareConfig, servos: Servos, reading: ServoReading) -> list[Finding]:
    """Joints out of their limits, and a forbidden posture."""
    angles = JointAngles(config.servos, config.head, reports_speed=servos.reports_speed)
    read = angles.update(reading)
    found = angles.angles.copy()
    findings = []
    for place, servo in enumerate(config.servos):
        angle_rad = float(found[servo.slot])
        if not read[place]:
            found[servo.slot] = float("nan")
            continue
        beyond_rad = max(servo.lower_rad - angle_rad, angle_rad - servo.upper_rad)
        if beyond_rad > _JOINT_LIMIT_TOLERANCE_RAD:
            position = servo.position_text(float(reading.angles[place]))
            findings.append(
                Finding(
                    part=f"servos: {servo.name}",
                    problem=f"expected an angle of {servo.lower_rad:.3f} to {servo.upper_rad:.3f} "
                    f"rad, got {angle_rad:.3f} rad (position {position})",
                    cure=f"turn it by hand with torque off, or mend {servo.zero_key}: "
                    "`vergence jog`",
                )
            )
    for posture in config.safety.forbidden:
        if posture.contains(found):
            problem = posture.refusal(found, config.slots)
            cure = "turn it out of there by hand with torque off"
            findings.append(Finding(part="safety", problem=problem, cure=cure))
    return findings


def check_robot(config: HardwareConfig) -> list[CheckedPart]:
    """Check the line, each servo and each camera, in this order; nothing is written to a servo."""
    if config.emulator_address:
        try:
            WorldClient(config.emulator_address).close()
        except HardwareError as error:
            problem = str(error).removeprefix("emulator: ")
            cure = "start `vergence emulate --out` anew, which writes its port and streams of then"
            finding = Finding(part="emulator", problem=problem, cure=cure)
            return [CheckedPart(name="emulator", description="", findings=(finding,))]
    there = {"bus": "", **{f"servos: {servo.name}": "" for servo in config.servos}}
    servos = config.make_servos(time.monotonic)
    try:
        servos.open()
    except ChecksFailedError as error:
        findings = list(error.findings)
        there |= servos.describe()
    else:
        try:
            findings = check_servos(config, servos)
            there |= servos.describe()
            angles = JointAngles(config.servos, config.head, reports_speed=servos.reports_speed)
            for servo, known in zip(config.servos, angles.update(servos.read()), strict=True):
                if known:
                    told = there[f"servos: {servo.name}"]
                    at = f"at {angles.angles[servo.slot]:.3f} rad"
                    there[f"servos: {servo.name}"] = f"{told}, {at}" if told else at
        finally:
            servos.close()
    states, found = check_cameras(camera_requests(config))
    findings += found
    there |= {camera.name: "" for camera in config.cameras}
    for state in states:
        size = "" if state.size is None else f"{_size(state.size)}, "
        there[state.request.name] = f"{size}{state.rate_hz:.1f} images a second"
    for finding in findings:  # of several parts at once, such as all cameras
        there.setdefault(finding.part, "")
    return [
        CheckedPart(
            name=part,
            description=what,
            findings=tuple(one for one in findings if one.part == part),
        )
        for part, what in there.items()
    ]

"""Checks of both cameras at once, before anything moves."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from vergence.errors import Finding
from vergence.hardware.checks.camera_states import (
    FIRST_IMAGE_TIMEOUT_S,
    CameraRequest,
    CameraState,
    CaptureDevice,
    camera_requests,
    measure_cameras,
)
from vergence.hardware.config import HardwareConfig
from vergence.vision.image import is_local_camera, open_capture

__all__ = [
    "CameraRequest",
    "CameraState",
    "camera_requests",
    "check_cameras",
    "check_local_cameras",
]

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
    seconds: float = 1.0,
) -> tuple[list[CameraState], list[Finding]]:
    """Find all problems of the cameras; for the arguments see `measure_cameras`.

    Returns:
        States of the cameras that could be opened, and the findings of all cameras.
    """
    states, unopened = measure_cameras(requests, open=open, clock=clock, seconds=seconds)
    findings = [
        _unopened(request, unopened[request.name])
        for request in requests
        if request.name in unopened
    ]
    for state in states:
        findings += _judge(state)
    shared = [state for state in states if state.slowed_by_others]
    return states, [*findings, _bandwidth(shared)] if shared else findings


def check_local_cameras(config: HardwareConfig) -> list[Finding]:
    """Find all problems of those cameras of a robot that are connected to this machine.

    Streams over the network are left out, as they are checked while they run.

    Args:
        config: the robot.
    """
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
            how = (
                "locked"
                if state.exposure_locked
                else "automatic"
                if state.exposure_locked is False
                else "unknown"
            )
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

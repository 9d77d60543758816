"""Requests to the world of an emulated head: placing the target, faults, ground truth.

Request and answer are a line of JSON each, with nan and inf, over TCP. Times are those of the
machine's monotonic clock, which all its processes share.
"""

import json
import socket
from collections.abc import Mapping
from typing import Any, Final

from vergence.envs.reading import Truth
from vergence.errors import HardwareError
from vergence.models.head import HeadModel
from vergence.models.parts import FloatArray

_TIMEOUT_S: Final = 5.0
"""Longest wait for the connection or an answer, s (chosen)."""


class WorldClient:
    """A connection to the world of an emulated head.

    Args:
        address: HOST:PORT of the world.

    Raises:
        HardwareError: nothing answers there.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=_TIMEOUT_S)
        except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
            raise HardwareError(
                f"emulator: expected an emulated head at {address}, got none: "
                f"{getattr(error, 'strerror', None) or error} (does vergence emulate still run?)"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._answers = self._socket.makefile("rb")

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request and wait for its answer.

        Raises:
            HardwareError: no answer arrives, or the answer is an error.
        """
        try:
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = self._answers.readline()
        except OSError as error:
            raise self._gone(error.strerror or str(error)) from error
        if not line:
            raise self._gone("it has ended")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise HardwareError(f"emulator: {answer['error']}")
        return answer

    def _gone(self, reason: str) -> HardwareError:
        return HardwareError(
            f"emulator: expected an answer of the emulated head at {self._address}, got none: "
            f"{reason}"
        )

    def place_target(self, motion: FloatArray) -> None:
        """Place a target at the start of a motion, see `vergence.envs.targets.motion`."""
        self.ask({"show": motion.tolist()})

    def start_target_motion(self, now_s: float) -> None:
        """Start the motion of the target that was placed: this instant is time 0 of its path."""
        self.ask({"begin": now_s})

    def turn(self, angles: Mapping[str, float]) -> None:
        """Put emulated joints at angles at once, rad by the actuator's name.

        It is for a bus of one's own that moves them; the emulated cameras show them there. Servos
        without torque stay; with torque they go on to their goals. An angle beyond an end stop
        becomes that stop's.

        Raises:
            HardwareError: no such actuator, or an angle that is not finite.
        """
        self.ask({"turn": dict(angles)})

    def begin_fault(self, **request: Any) -> float:
        """Begin a fault, see `vergence.hardware.emulator.faults`; return when, s."""
        return float(self.ask({"fault": request})["time"])

    def clear_faults(self) -> None:
        """End all active faults; `overload`, `reboot` and `unplug` cannot end."""
        self.ask({"clear": None})

    def rest_start_s(self, since: float) -> float | None:
        """Time since when, from a time at most 20 s ago on, all joints rest; None if one turns.

        At rest a joint turns at 0.024 rad/s at most. Times are of the monotonic clock, s.
        """
        rested_s: float | None = self.ask({"rest": {"since": since}})["rested_s"]
        return rested_s

    def truth(self, head: HeadModel, time_s: float) -> Truth:
        """Present ground truth, with the pixel errors of the model that the controller uses.

        `time_s` is the time since the trial's start.
        """
        told = self.ask({"state": None})
        truth = Truth.unknown(1)
        truth.time_s[0] = time_s
        for name in ("positions", "velocities", "motors", "target", "pixels"):
            getattr(truth, name)[0] = told[name]
        truth.pixel_error[0] = head.undistort(truth.pixels[0]) - head.cameras.principal
        pixels, size = truth.pixels[0], head.cameras.size
        truth.image_visible[0] = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=-1)
        return truth

    def close(self) -> None:
        """Close the connection."""
        self._answers.close()
        self._socket.close()

"""A user's detector in a process of its own: Python code that computes cannot hold up a robot.

Threads of one process take turns at Python code. A control loop gives way some ten times a period,
and would wait each time for a detector that computes. The parent writes an image to the process'
standard input and reads the answer from its standard output, both pickled.
"""

import os
import pickle
import signal
import subprocess
import sys
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, Final

from vergence.errors import ConfigurationError, VergenceError
from vergence.models.camera import Camera
from vergence.vision.objects.targets import OwnTarget

_NICENESS: Final = 10
"""Niceness of the process: where processors are few, the control loop goes first (chosen)."""
_END_S: Final = 2.0
"""Longest wait for the process to end when it is told to, s (chosen: code that hears signals)."""


class WorkerDetector:
    """A user's detector in a process of its own, see `CheckedDetector`.

    Args:
        target: the target.
        camera: the camera of the eye.

    Attributes:
        own: what the detector states: `both_eyes`.

    Raises:
        ConfigurationError: the class cannot be loaded.
    """

    def __init__(self, target: OwnTarget, camera: Camera) -> None:
        self._spec = target.entry.spec
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        try:
            self.own = SimpleNamespace(both_eyes=self._ask((sys.path, target, camera)))
        except ConfigurationError:
            self.close()
            raise

    def detect(self, image: Any, hint: Any) -> Any:
        """See `Detector.detect`.

        Raises:
            ConfigurationError: it raises, ends, or returns something else than detections.
        """
        return self._ask((image, hint))

    def _ask(self, question: Any) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            pickle.dump(question, self._process.stdin, pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
            answer, error = pickle.load(self._process.stdout)  # written by our own process
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as broken:
            raise ConfigurationError(
                f"target {self._spec}: expected its process to answer, but it has ended"
            ) from broken
        if error:
            raise ConfigurationError(error)
        return answer

    def close(self) -> None:
        """End the process, at work or not, and so the call that waits for its answer."""
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


def main() -> None:
    """Answer questions of the parent until it ends."""
    from vergence.vision.objects.detectors import CheckedDetector

    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this one
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the user's code prints must not be read as an answer
    detector: Any = None
    with suppress(EOFError, OSError):
        while True:
            question = pickle.load(questions)
            answer, error = None, ""
            try:
                if detector is None:
                    path, target, camera = question
                    sys.path[:] = path
                    detector = CheckedDetector(target, camera)
                    answer = bool(getattr(detector.own, "both_eyes", False))
                else:
                    answer = detector.detect(*question)
            except VergenceError as refused:
                error = str(refused)
            answers.write(pickle.dumps((answer, error), pickle.HIGHEST_PROTOCOL))
            answers.flush()


if __name__ == "__main__":
    main()

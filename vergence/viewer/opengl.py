"""Check that MuJoCo can be imported with the OpenGL of this machine, which nothing here needs.

MuJoCo reads the variable `MUJOCO_GL` when it is imported. The import fails if the library named
there is missing.
"""

import os
import subprocess
import sys
from typing import Final

_BACKEND_VARIABLE: Final = "MUJOCO_GL"
_IMPORTABLE_VALUES: Final = ("", "glfw", "disable", "disabled", "off", "false", "0")
"""Values with which MuJoCo can be imported anywhere."""
_TIMEOUT_S: Final = 30
"""Time limit of a trial process, s (chosen: patience with slow machines against a long wait)."""


def disable_broken_opengl() -> str | None:
    """Disable OpenGL if MuJoCo cannot be imported with it; call before importing MuJoCo.

    Returns:
        The reason if OpenGL is disabled, for this process and its child processes; else None.
    """
    chosen = os.environ.get(_BACKEND_VARIABLE, "").strip().lower()
    if chosen not in _IMPORTABLE_VALUES:
        reason = _failure("import mujoco")
        if reason is not None:
            os.environ[_BACKEND_VARIABLE] = "disable"
            return f"{_BACKEND_VARIABLE}={chosen}: {reason}"
    return None


def _failure(code: str) -> str | None:
    """Reason why Python code fails, else None; run in a separate process, as OpenGL may abort."""
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"no answer within {_TIMEOUT_S} s"
    except OSError as error:
        return error.strerror or str(error)
    if done.returncode == 0:
        return None
    said = done.stderr.decode(errors="replace").partition("Exception ignored")[0]  # at exit
    lines = [line for line in said.splitlines() if line and not line.startswith(" ")]
    return lines[-1] if lines else f"ended with code {done.returncode}"

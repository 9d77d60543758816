"""Check of MuJoCo's OpenGL rendering on this machine, with the reason for a failure.

MuJoCo reads the variable `MUJOCO_GL` when it is imported. The import fails if the library named
there is missing.
"""

import functools
import os
import subprocess
import sys
from importlib.util import find_spec
from typing import Final

from vergence.errors import how_to_install

_BACKEND_VARIABLE: Final = "MUJOCO_GL"
_IMPORTABLE_VALUES: Final = ("", "glfw", "disable", "disabled", "off", "false", "0")
"""Values with which MuJoCo can be imported anywhere."""
_TIMEOUT_S: Final = 30
"""Time limit of a trial process, s (chosen: patience with slow machines against a long wait)."""

_switched_off: str | None = None


def disable_broken_opengl() -> str | None:
    """Disable OpenGL if MuJoCo cannot be imported with it; call before importing MuJoCo.

    Returns:
        The reason if OpenGL is disabled, for this process and its child processes; else None.
    """
    global _switched_off
    chosen = os.environ.get(_BACKEND_VARIABLE, "").strip().lower()
    if chosen not in _IMPORTABLE_VALUES:
        reason = _failure("import mujoco")
        if reason is not None:
            _switched_off = f"{_BACKEND_VARIABLE}={chosen}: {reason}"
            os.environ[_BACKEND_VARIABLE] = "disable"
    return _switched_off


@functools.cache
def opengl_failure() -> str | None:
    """Reason why MuJoCo's renderer does not work on this machine; None if it works."""
    if find_spec("OpenGL") is None:
        return f"PyOpenGL is not installed: {how_to_install('render')}"
    return _switched_off or _failure(
        "import mujoco as m; r = m.Renderer(m.MjModel.from_xml_string('<mujoco/>'), 8, 8); "
        "r.update_scene(m.MjData(r.model)); r.render(); r.close()"
    )


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

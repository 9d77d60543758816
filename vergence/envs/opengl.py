"""Whether MuJoCo can draw here through OpenGL, and why not.

MuJoCo reads `MUJOCO_GL` when it is imported, and cannot be imported at all where the library that
is named there is missing.
"""

import functools
import os
import subprocess
import sys
from importlib.util import find_spec
from typing import Final

from vergence.errors import how_to_install

_VARIABLE: Final = "MUJOCO_GL"
_HARMLESS: Final = ("", "glfw", "disable", "disabled", "off", "false", "0")
"""Values with which MuJoCo can be imported anywhere."""
_TIMEOUT_S: Final = 30

_switched_off: str | None = None


def switch_off_what_fails() -> str | None:
    """Go on without OpenGL where MuJoCo could not be imported with it; call before its import.

    Returns:
        Why, where it is switched off, for this process and those that it starts.
    """
    global _switched_off
    chosen = os.environ.get(_VARIABLE, "").strip().lower()
    if chosen not in _HARMLESS:
        reason = _failure("import mujoco")
        if reason is not None:
            _switched_off = f"{_VARIABLE}={chosen}: {reason}"
            os.environ[_VARIABLE] = "disable"
    return _switched_off


@functools.cache
def opengl_failure() -> str | None:
    """Why MuJoCo's renderer cannot draw here; None where it can."""
    if find_spec("OpenGL") is None:
        return f"PyOpenGL is not installed: {how_to_install('render')}"
    return _switched_off or _failure(
        "import mujoco as m; r = m.Renderer(m.MjModel.from_xml_string('<mujoco/>'), 8, 8); "
        "r.update_scene(m.MjData(r.model)); r.render(); r.close()"
    )


def _failure(code: str) -> str | None:
    """Why some Python fails; it runs in a process of its own, as OpenGL may abort."""
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

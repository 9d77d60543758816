"""Active binocular vision: two camera eyes turn until both look straight at a target.

Importing the package registers its Gymnasium environments, at once or when Gymnasium is imported;
modules that need NumPy or compiled kernels are loaded at their first use.
"""

# imported first, so that Ctrl-C during further imports ends the command line without a stack trace
import vergence.interrupts  # noqa: F401  # isort: skip

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from vergence.envs import register_environments_with_gymnasium
from vergence.errors import VergenceError, VergenceWarning

if TYPE_CHECKING:
    __version__: str
    from vergence.controllers import make_controller
    from vergence.models import HeadModel, ModelErrors, load_head
    from vergence.triangulation import (
        Fix,
        Noise,
        triangulate_fixations,
        triangulate_gaze,
        triangulate_views,
    )

__all__ = [
    "Fix",
    "HeadModel",
    "ModelErrors",
    "Noise",
    "VergenceError",
    "VergenceWarning",
    "__version__",
    "load_head",
    "make_controller",
    "triangulate_fixations",
    "triangulate_gaze",
    "triangulate_views",
]

_LAZY = {
    "Fix": "vergence.triangulation",
    "HeadModel": "vergence.models",
    "ModelErrors": "vergence.models",
    "Noise": "vergence.triangulation",
    "load_head": "vergence.models",
    "make_controller": "vergence.controllers",
    "triangulate_fixations": "vergence.triangulation",
    "triangulate_gaze": "vergence.triangulation",
    "triangulate_views": "vergence.triangulation",
}

register_environments_with_gymnasium()
# nothing is logged unless the application configures logging
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    if name == "__version__":
        return _version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:  # sources on the path, not installed
        return "0+unknown"

"""Active binocular vision: two camera eyes turn until both look straight at a target.

Importing the package registers its Gymnasium environments; modules that need compiled kernels are
loaded at their first use.
"""

# imported first, so that Ctrl-C during further imports ends the command line without a stack trace
from vergence import interrupts  # isort: skip

import logging
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from vergence.errors import VergenceError, VergenceWarning

if TYPE_CHECKING:
    __version__: str
    from vergence.controllers import make_controller
    from vergence.models import HeadModel, ModelErrors, load_head, look_at
    from vergence.triangulation.fix import (
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
    "look_at",
    "make_controller",
    "triangulate_fixations",
    "triangulate_gaze",
    "triangulate_views",
]

# modules with the other public names, the quickest to import first
_HOMES = ("vergence.models", "vergence.triangulation", "vergence.controllers")


# a help text is printed before Gymnasium is imported; code of users registers first in any case
if "gymnasium" in sys.modules or not interrupts.started_as_command:
    from vergence.entry_points import register_environments

    register_environments()
# nothing is logged unless the application configures logging
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version(__name__)
        except PackageNotFoundError:  # sources on the path, not installed
            return "0+unknown"
    for home in map(import_module, _HOMES if name in __all__ else ()):
        if hasattr(home, name):
            globals()[name] = getattr(home, name)  # found at once from now on
            return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

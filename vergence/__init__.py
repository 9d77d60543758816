"""Active binocular vision: two camera eyes turn until both look straight at a target.

Importing the package registers its Gymnasium environments.
"""

from importlib.metadata import PackageNotFoundError, version

from vergence.controllers import make_controller
from vergence.envs import register_environments
from vergence.errors import VergenceError
from vergence.models import HeadModel, ModelErrors, load_head
from vergence.triangulation import Fix, Noise, triangulate_gaze, triangulate_views

try:
    __version__ = version("vergence")
except PackageNotFoundError:  # sources on the path, not installed
    __version__ = "0+unknown"

__all__ = [
    "Fix",
    "HeadModel",
    "ModelErrors",
    "Noise",
    "VergenceError",
    "__version__",
    "load_head",
    "make_controller",
    "triangulate_gaze",
    "triangulate_views",
]

register_environments()

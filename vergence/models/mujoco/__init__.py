"""The head as a MuJoCo model; and `mujoco` itself, or an error that names the cure."""

from importlib.metadata import PackageNotFoundError, version

from vergence.errors import MujocoUnavailableError

try:
    import mujoco
    from mujoco.batch import Batch

    mujoco.MjSpec, mujoco.mj_version  # a core without its files is an empty package  # noqa: B018
except Exception as error:
    try:
        found = version("mujoco")
    except PackageNotFoundError:
        found = "none"
    cure = "pip install 'mujoco>=4,<5'"
    if found.startswith("4."):  # an uninstalled older one took files of the core along
        # of one version: MuJoCo's own advice lets pip take a newer core, which mujoco refuses
        parts = (f"{name}=={found}" for name in ("mujoco", "mujoco-core", "mujoco-studio"))
        cure = f"pip install --force-reinstall --no-deps {' '.join(parts)}"
        found += " with files that are missing or damaged"
    fault = f"mujoco: expected MuJoCo 4, got {found}; cure: {cure}"
    raise MujocoUnavailableError(fault) from error

__all__ = ["Batch", "mujoco"]

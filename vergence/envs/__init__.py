"""The task and the simulated heads, as Gymnasium environments."""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Final

__all__ = ["MAX_EPISODE_STEPS", "register_environments_with_gymnasium"]

MAX_EPISODE_STEPS: Final = 240
"""Steps of an episode of the registered environments: 2 s at 120 Hz (chosen: time to settle
against time of a simulation)."""


_REGISTRATION: Final = "gymnasium.envs.registration"
"""Gymnasium's module that has the registry."""


def register_environments_with_gymnasium() -> None:
    """Register the package's environments once Gymnasium is imported, which may be never."""
    if _REGISTRATION in sys.modules:
        _register_environments()
    else:
        sys.meta_path.insert(0, _GymnasiumImport())


class _GymnasiumImport:
    """Import hook that registers the environments as soon as Gymnasium has its registry.

    Gymnasium takes longer to import than a help text to print.
    """

    def find_spec(
        self, name: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != _REGISTRATION:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register_environments()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


def _register_environments() -> None:
    from gymnasium.envs.registration import register, registry

    if "vergence/Gaze-v0" not in registry:
        register(
            id="vergence/Gaze-v0",
            entry_point="vergence.envs.gaze:GazeEnv",
            vector_entry_point="vergence.envs.gaze:GazeVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
    if "vergence/GainSchedule-v0" not in registry:
        register(
            id="vergence/GainSchedule-v0",
            entry_point="vergence.controllers.networks.environments:GainScheduleEnv",
            vector_entry_point="vergence.controllers.networks.environments:GainScheduleVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
    if "vergence/GazeHardware-v0" not in registry:
        # its episodes last for seconds, whatever the control rate
        register(
            id="vergence/GazeHardware-v0", entry_point="vergence.hardware.gaze:GazeHardwareEnv"
        )

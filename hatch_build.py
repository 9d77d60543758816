"""Tag of a wheel: one that carries compiled kernels is for its Python and platform alone."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelTag(BuildHookInterface):
    """Hook that lets hatchling infer the tag where `make wheel` has compiled kernels."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Set the tag before the wheel is built."""
        shipped = Path(self.root, "vergence", "kernels", "shipped")
        if version == "standard" and shipped.is_dir():
            build_data |= {"pure_python": False, "infer_tag": True}

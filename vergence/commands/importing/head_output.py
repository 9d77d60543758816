"""What `vergence import` has in common: where the head file goes, options given again and again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vergence.errors import ConfigurationError

Words = Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction]
"""Values of an option that may be given once with all of them, or again and again."""


@dataclass(frozen=True, kw_only=True)
class HeadOutput:
    """Where the head file goes."""

    out: Path
    """Head file to write, such as head.toml."""
    force: bool = False
    """Replace a file of that name."""

    def check(self) -> None:
        """Refuse a place that the file cannot have, before any work is done.

        Raises:
            ConfigurationError: it is no .toml, or there is a file of that name.
        """
        if self.out.suffix != ".toml":
            raise ConfigurationError(f"out: expected a name that ends in .toml, got {self.out}")
        if self.out.exists() and not self.force:
            raise ConfigurationError(
                f"out: expected no file of that name (--force replaces it), got {self.out}"
            )

    def write(self, text: str) -> None:
        """Write the file, whole or not at all, in a folder that is made if it is missing."""
        from vergence.files import write_whole

        self.out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self.out, text)

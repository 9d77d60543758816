"""Options shared by the `vergence import` commands: output files, repeatable options."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.models.head import HeadModel

RepeatableValues = Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction]
"""Values of a repeatable option; each occurrence may have several values."""


def flatten_repeated_option(occurrences: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """All values of a repeatable option, in order."""
    return tuple(word for group in occurrences for word in group)


@dataclass(frozen=True, kw_only=True)
class HeadOutput:
    """Output files of an import."""

    out: Path = Path("head.toml")
    """Head file to write."""
    force: bool = False
    """Replace existing files."""
    figure: bool = True
    """Draw the head for a visual check, as .png beside the head file."""

    def check(self) -> None:
        """Refuse output files that cannot be written, before anything is written."""
        if self.out.suffix != ".toml":
            raise ConfigurationError(f"out: expected a name that ends in .toml, got {self.out}")
        for path in (self.out, *([self._drawing] if self.figure else [])):
            if path.exists() and not self.force:
                raise ConfigurationError(
                    f"out: expected no file of that name (--force replaces it), got {path}"
                )

    def write(self, text: str, head: "HeadModel") -> None:
        """Write head file and drawing atomically; before printing, as a closed pipe ends all."""
        from vergence.files import atomic_files

        self.out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_files(self.out.parent, moved_last=self.out.name) as beside:
            (beside / self.out.name).write_text(text, encoding="utf-8")
            if self.figure:
                from vergence.eval.head_figure import draw_head

                draw_head(head, beside / self._drawing.name)

    def print_paths(self) -> None:
        """Print the paths of the written files."""
        print(self.out)
        if self.figure:
            print(self._drawing)

    @property
    def _drawing(self) -> Path:
        return self.out.with_suffix(".png")

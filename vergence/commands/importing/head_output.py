"""What `vergence import` has in common: where the head file goes, options given again and again."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    from vergence.models.head import HeadModel

Words = Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction]
"""Values of an option that may be given once with all of them, or again and again."""


def flat(words: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """All values of such an option, in their order."""
    return tuple(word for group in words for word in group)


@dataclass(frozen=True, kw_only=True)
class HeadOutput:
    """Where the head file goes."""

    out: Path = Path("head.toml")
    """Head file to write."""
    force: bool = False
    """Replace files of these names."""
    figure: bool = True
    """Draw the head to check it, beside the head file, as .png."""

    def check(self) -> None:
        """Refuse a place that the files cannot have, before anything is written.

        Raises:
            ConfigurationError: it is no .toml, or there is a file of that name.
        """
        if self.out.suffix != ".toml":
            raise ConfigurationError(f"out: expected a name that ends in .toml, got {self.out}")
        for path in (self.out, *([self._drawing] if self.figure else [])):
            if path.exists() and not self.force:
                raise ConfigurationError(
                    f"out: expected no file of that name (--force replaces it), got {path}"
                )

    def write(self, text: str, head: "HeadModel") -> None:
        """Write the head file and its drawing, each whole or not at all.

        To be called before anything is printed: a reader of the printed may leave early.

        Args:
            text: of the head file; its folder is made if it is missing.
            head: what it says.

        Raises:
            OSError: a file cannot be written.
        """
        from vergence.files import write_atomic

        self.out.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.out, text)
        if self.figure:
            from vergence.eval.head_figure import draw_head

            draw_head(head, self._drawing)

    def say(self) -> None:
        """Print what has been written."""
        print(self.out)
        if self.figure:
            print(self._drawing)

    @property
    def _drawing(self) -> Path:
        return self.out.with_suffix(".png")

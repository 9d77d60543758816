"""`vergence export`: the head for use elsewhere."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write the head as a MuJoCo model or a URDF, for use elsewhere."""

    format: Annotated[Literal["mjcf", "urdf"], tyro.conf.Positional]
    """File format."""
    head: str = "simulated"
    """Head: a preset's name or the path of a TOML file."""
    out: Path | None = None
    """Folder to write to, new or empty; export-FORMAT-HEAD by default."""

    def run(self) -> int:
        """Run the command."""
        from vergence.eval.runs import run_folder
        from vergence.models.export import export_files
        from vergence.models.head_file import load_head

        head = load_head(self.head)
        folder = self.out or Path(f"export-{self.format}-{head.name}")
        with run_folder(folder) as partial:
            for name, content in export_files(head, self.format).items():
                path = partial / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                print(path)
        return 0

"""`vergence view`: a head in the browser, simulated, recorded or live."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from vergence.commands.console import print_to_stderr
from vergence.commands.extras import require_modules


@dataclass(frozen=True, kw_only=True)
class View:
    """Show a head in the browser: drag its target, change its law and the faults of its loop."""

    head: Annotated[str, tyro.conf.arg(metavar="HEAD")] = "simulated"
    """Head: a preset's name (see `vergence info`) or the path of a TOML file."""
    controller: Annotated[str, tyro.conf.arg(metavar="CONTROLLER")] = "saccade"
    """Controller at first (see `vergence info`)."""
    host: str = "127.0.0.1"
    """Address to listen on; by default browsers of this machine alone can see the page."""
    port: int = 8080
    """Port to listen on; the next free one if it is taken."""
    no_browser: bool = False
    """Print the address, and open no browser."""

    def run(self) -> int:
        """Run the command."""
        require_modules("view", "viser")
        import webbrowser

        from vergence.models.files.head_file import load_head
        from vergence.viewer.browser import address_of, serving
        from vergence.viewer.playground import Playground
        from vergence.viewer.simulated import Setup

        setup = Setup(head=load_head(self.head), controller=self.controller)
        with serving(self.host, self.port) as server:
            playground = Playground(server, setup)
            print_to_stderr(f"showing on {address_of(server)} until Ctrl-C")
            if not self.no_browser:
                webbrowser.open(address_of(server))
            playground.run()
        return 0

"""Server of the viewer's page, for browsers on this machine unless told otherwise."""

import contextlib
import io
from collections.abc import Iterator
from contextlib import contextmanager

import viser

Server = viser.ViserServer
"""Server of the viewer's page."""


@contextmanager
def serving(host: str, port: int) -> Iterator[viser.ViserServer]:
    """Serve the viewer's page until the end of the `with` block.

    Args:
        host: address to listen on.
        port: TCP port; a later one if it is taken, any free one for 0.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # it greets with a box
        server = viser.ViserServer(host, port, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+z")
    server.scene.configure_environment_map(None)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def address_of(server: viser.ViserServer) -> str:
    """Address of the page."""
    host = server.get_host()
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"

"""Server of the viewer's page, for browsers on this machine unless told otherwise."""

import contextlib
import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import viser

from vergence.errors import ConfigurationError

Server = viser.ViserServer
"""Server of the viewer's page."""


@contextmanager
def serving(host: str, port: int) -> Iterator[viser.ViserServer]:
    """Serve the viewer's page until the end of the `with` block.

    Args:
        host: address to listen on.
        port: TCP port; a later one if it is taken, any free one for 0.

    Raises:
        ConfigurationError: the address is none of this machine's.
    """
    _check_address(host)
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
    host = "localhost" if host in ("", "0.0.0.0", "::") else host
    return f"http://{f'[{host}]' if ':' in host else host}:{server.get_port()}"


def _check_address(host: str) -> None:
    """Refuse an address that cannot be listened on: the server would try ports for ever."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.create_server((host, 0), family=family):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"host: expected an address of this machine, got {host!r} ({error.strerror or error})"
        ) from error

"""A server of the viewer's page on a free port."""

import pytest


@pytest.fixture
def served():
    """The server; no browser need connect to it."""
    from vergence.viewer.browser import serving

    with serving("127.0.0.1", 0) as server:
        yield server

"""Check for optional dependencies that a command needs beyond the base install."""

from importlib.util import find_spec

from vergence.errors import ConfigurationError, how_to_install


def require_modules(extra: str, *modules: str) -> None:
    """Check that optional modules are installed."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"expected {', '.join(missing)} to be installed: {how_to_install(extra)}"
        )

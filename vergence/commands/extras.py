"""Check for optional dependencies that a command needs beyond the base install."""

from importlib.util import find_spec

from vergence.errors import ConfigurationError, how_to_install


def require_modules(extra: str, *modules: str) -> None:
    """Check that optional modules are installed.

    Args:
        extra: name of the extra that installs the modules.
        *modules: names of the modules.

    Raises:
        ConfigurationError: a module is missing.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"expected {', '.join(missing)} to be installed: {how_to_install(extra)}"
        )

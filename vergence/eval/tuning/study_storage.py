"""Where a study is kept: a SQLite file, or a PostgreSQL database for many machines."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from vergence.errors import ConfigurationError

if TYPE_CHECKING:
    import optuna

_CONNECT_TIMEOUT_S: Final = 10


def open_storage(place: str) -> "optuna.storages.RDBStorage":
    """Optuna's storage at a place.

    Args:
        place: a file, which is made if it is not there, or the URL of a database.

    Raises:
        ConfigurationError: the file cannot be made.
        SQLAlchemyError: the database cannot be opened.
    """
    import optuna

    url = _url(place)
    # a server that takes the connection and says nothing would be waited for without end
    patient = url.startswith("sqlite") or "connect_timeout=" in url
    connect = {} if patient else {"connect_timeout": _CONNECT_TIMEOUT_S}
    return optuna.storages.RDBStorage(url, engine_kwargs={"connect_args": connect})


def without_password(storage: str) -> str:
    """A study's place as it may be shown and written down.

    Args:
        storage: a file, or a URL.

    Returns:
        The same with stars for a URL's password.
    """
    return re.sub(r"(://[^/?#:]*:)[^/?#]*@", r"\1***@", storage)


def _url(storage: str) -> str:
    if "://" not in storage:
        path = Path(storage)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(
                f"storage: expected a file that can be made, got {storage}: {error.strerror}"
            ) from error
        return f"sqlite:///{path.absolute()}"
    kind, _, rest = storage.partition("://")
    # SQLAlchemy would look for psycopg2 behind the plain name
    return f"postgresql+psycopg://{rest}" if kind in ("postgresql", "postgres") else storage

"""Storage of a study: a SQLite file, or a PostgreSQL database for several machines."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

import optuna
from optuna import Study
from optuna.exceptions import StorageInternalError
from optuna.samplers import BaseSampler
from optuna.storages import RDBStorage
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from vergence.errors import ConfigurationError

_CONNECT_TIMEOUT_S: Final = 10
"""Time limit for connecting to a PostgreSQL server, s (chosen: slow networks against waiting)."""
_CREATION_RACE_ERRORS: Final = (
    "already exists",
    "UniqueViolation",
    "UNIQUE constraint",
    "is locked",
)
_RETRY_PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, None)


@contextmanager
def open_study(file_or_url: str, name: str, sampler: BaseSampler) -> Iterator[Study]:
    """Open or create a study; its connections are closed at the end of the context.

    Args:
        file_or_url: a file, which is created if it does not exist, or the URL of a database.
        name: the study's name.
        sampler: the sampler that chooses its points.

    Yields:
        The study.

    Raises:
        ConfigurationError: the storage cannot be opened, read or written.
    """
    try:
        study, storage = _create(file_or_url, name, sampler)
    except (SQLAlchemyError, ImportError, RuntimeError) as error:
        raise ConfigurationError(
            f"storage: expected a SQLite file or a PostgreSQL URL that can be opened, got "
            f"{without_password(file_or_url)}: {str(error).splitlines()[0]}"
        ) from error
    try:
        yield study
    except (SQLAlchemyError, StorageInternalError) as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else error
        raise ConfigurationError(
            f"storage: {without_password(file_or_url)} can no longer be read or written: "
            f"{str(cause or error).splitlines()[0]} (what is in it stays; the next call goes on)"
        ) from error
    finally:
        with suppress(SQLAlchemyError):
            storage.remove_session()
        storage.engine.dispose()


def _create(place: str, name: str, sampler: BaseSampler) -> tuple[Study, RDBStorage]:
    """Open or create the study; retry if another process is creating the tables meanwhile."""
    url = _url(place)
    # without a timeout, a server that accepts the connection but never answers would block forever
    patient = url.startswith("sqlite") or "connect_timeout=" in url
    connect = {} if patient else {"connect_timeout": _CONNECT_TIMEOUT_S}
    for pause_s in _RETRY_PAUSES_S:
        try:
            storage = RDBStorage(url, engine_kwargs={"connect_args": connect})
            study = optuna.create_study(
                storage=storage,
                study_name=name,
                sampler=sampler,
                direction="minimize",
                load_if_exists=True,
            )
            return study, storage
        except DBAPIError as error:
            if pause_s is None or not any(word in str(error) for word in _CREATION_RACE_ERRORS):
                raise
            time.sleep(pause_s)
    raise AssertionError("the last pause is None")


def without_password(storage: str) -> str:
    """Hide the password of a study's storage, for messages and files.

    Args:
        storage: a file, or a URL.

    Returns:
        The storage, with stars in place of a URL's password.
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
    # for the plain name, SQLAlchemy would require psycopg2
    return f"postgresql+psycopg://{rest}" if kind in ("postgresql", "postgres") else storage

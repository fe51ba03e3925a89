"""Finds out soon whether a store of MLflow's can be used: libraries wait for minutes where nobody answers.

The first connection gets `FIRST_CONNECTION_S`; while it is waited for, a line says so. Nothing here changes a store.
"""

import socket
import sqlite3
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote, urlsplit

from pipeline.base import console

FIRST_CONNECTION_S = 20.0
"""How long an address may take to answer for the first time, or a database to be free."""
SILENT_S = 1.0
"""A line says what is waited for where it takes longer than this."""
SQLITE = "sqlite:///"

_WEB_PORTS = {"http": 80, "https": 443}
_DATABASE_PORTS = {"postgresql": 5432, "mysql": 3306, "mssql": 1433}


class UnusableError(Exception):
    """Nothing can be kept at the address; the message says why."""


def database_file(uri: str) -> Path:
    """Return the file of an ``sqlite:///`` address."""
    return Path(uri.removeprefix(SQLITE)).expanduser().absolute()


def check_usable(uri: str) -> None:
    """Raise `UnusableError` where nobody answers, a driver is missing, or a database is locked or damaged."""
    scheme = uri.partition(":")[0].partition("+")[0]
    if uri.startswith(SQLITE):
        _check_sqlite(database_file(uri))
    elif scheme in _WEB_PORTS:
        _check_answers(uri, _WEB_PORTS[scheme])
    elif scheme in _DATABASE_PORTS:
        _check_driver(uri)
        _check_answers(uri, _DATABASE_PORTS[scheme])
    elif scheme == "sqlite":
        raise UnusableError(f"write {SQLITE}FILE, with three slashes, or four before a path from the root")


def _check_answers(uri: str, usual_port: int) -> None:
    try:
        address = urlsplit(uri)
        host, port = address.hostname or "", address.port or usual_port
    except ValueError as error:
        raise UnusableError(str(error)) from error

    def connect(timeout_s: float) -> None:
        socket.create_connection((host, port), timeout_s).close()

    try:
        _patiently(connect, f"{host}:{port}", TimeoutError)
    except OSError as error:
        raise UnusableError(f"nobody answers at {host}:{port} ({error}); start the server, or correct it") from error


def _check_driver(uri: str) -> None:
    from sqlalchemy.engine import make_url  # MLflow brings it; it takes a moment to import
    from sqlalchemy.exc import SQLAlchemyError

    try:
        make_url(uri).get_dialect().import_dbapi()
    except ImportError as error:
        raise UnusableError(f"the database's driver is not installed ({error})") from error
    except SQLAlchemyError as error:
        raise UnusableError(str(error)) from error


def _check_sqlite(database: Path) -> None:
    if database.is_dir():
        raise UnusableError(f"{database} is a folder; give a file in it, as in {SQLITE}{database / 'mlflow.db'}")
    if not database.exists():
        return

    def lock(timeout_s: float) -> None:
        connection = sqlite3.connect(f"file:{quote(str(database))}?mode=rw", timeout_s, isolation_level=None, uri=True)
        try:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("SELECT count(*) FROM sqlite_master")
        finally:
            connection.close()

    try:
        _patiently(lock, f"{database}, which another process has locked,", sqlite3.OperationalError)
    except sqlite3.Error as error:
        raise UnusableError(f"{database}: {error}; free or repair it, or give another file") from error


def _patiently(attempt: Callable[[float], None], what: str, too_soon: type[Exception]) -> None:
    """Try with a short time limit, and where that was ``too_soon``, say so and try with a long one."""
    try:
        attempt(SILENT_S)
    except too_soon:
        console.line(f"waiting for {what} at most {FIRST_CONNECTION_S:.0f} s")
        attempt(FIRST_CONNECTION_S)

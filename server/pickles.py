"""Keeps pickles out of the job engine, which would read one from any row that says it is one."""

from typing import Any

from dbos import _serialization as serialization

from server.errors import ServiceError


class PickleError(ServiceError):
    """A row of the job engine holds a pickle, which would run code when read."""


def refuse_pickles() -> None:
    """Make this process refuse to read or write a pickle in the engine's tables.

    Otherwise anyone who may write to the database could run code in every worker and in the service.
    """
    serialization.DefaultSerializer.deserialize = _refuse_reading
    serialization.DefaultSerializer.serialize = _refuse_writing


def _refuse_reading(cls: object, serialized_data: str) -> Any:
    raise PickleError("found a pickle in the job engine's tables", "portable JSON", "somebody else wrote there")


def _refuse_writing(self: object, data: Any) -> str:
    raise PickleError("found job state about to be pickled", "portable JSON")

"""Errors of the service; `server.middleware.problems` maps each to an HTTP status."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType

from rigs.errors import Spike4dgsError


class ServiceError(Spike4dgsError):
    """Root of the errors raised by `server`; `headers` go into the answer that tells of it."""

    headers: Mapping[str, str] = MappingProxyType({})


class NotFoundError(ServiceError):
    """No rig, capture, job or artefact has this name."""


class RigBusyError(ServiceError):
    """The rig is recording; it records one capture at a time."""


class StateError(ServiceError):
    """The capture or job is not in a state that allows this."""


class UnknownReferenceError(ServiceError):
    """The request names something that does not exist or does not fit."""


class ForeignRequestError(ServiceError):
    """The request came through a host name or from a page that is not this service's."""


class IdempotencyError(ServiceError):
    """An Idempotency-Key came again with another request."""


class PreconditionError(ServiceError):
    """The thing to be changed is no longer what the client saw."""


class PreconditionRequiredError(ServiceError):
    """A request for a change does not say which version it changes."""


class RigMismatchError(ServiceError):
    """A recording or rig file is of other cameras than the rig's."""


class OffsetError(ServiceError):
    """A piece of an upload does not begin where the last one ended; `headers` have where that is."""

    def __init__(self, found: int, expected: int) -> None:
        super().__init__(f"found the offset {found}", str(expected), "send the bytes from there on")
        self.headers = {"Upload-Offset": str(expected)}


class UploadSizeError(ServiceError):
    """An upload is longer than it may be, or not as long as it was said to be."""


class UploadDiskError(ServiceError):
    """The disk has no room for an upload; the `offset` bytes that came before are kept."""

    def __init__(self, reason: str, offset: int) -> None:
        super().__init__(f"found no room on the disk ({reason})", "enough for the upload", "free some and go on")
        self.headers = {"Upload-Offset": str(offset)}


class NoRoomError(ServiceError):
    """The disk has no room for what is asked for, beside what it has promised already."""


class RangeError(ServiceError):
    """A Range makes no sense, or has none of the `size` bytes that there are."""

    def __init__(self, found: str, size: int) -> None:
        super().__init__(f"found the Range {found[:60]!r}", f"bytes=FIRST-LAST within {size} bytes")
        self.headers = {"Content-Range": f"bytes */{size}"}


class DigestError(ServiceError):
    """The bytes that were sent are not the ones that were announced."""


class UnauthorizedError(ServiceError):
    """The request carries no token of this service, which needs one."""

    headers = MappingProxyType({"WWW-Authenticate": 'Bearer realm="spike4dgs"'})


class ForbiddenError(ServiceError):
    """The request's token does not allow this."""


class BusyClientError(ServiceError):
    """The client asks too often; it may ask again when `headers` say."""

    def __init__(self, wait_s: int) -> None:
        super().__init__("found too many requests of one client", "fewer", f"ask again in {wait_s} s")
        self.headers = {"Retry-After": str(wait_s)}


class TooLargeError(ServiceError):
    """The body is longer than any that makes sense here."""


class SlowBodyError(ServiceError):
    """The body does not come."""


class MalformedError(ServiceError):
    """The body is no JSON, or JSON that two readers may read differently."""


class TokenError(ServiceError):
    """A token's name is taken, or unknown."""

    exit_code = 2


class ExposedError(ServiceError):
    """Anyone elsewhere could reach the service."""

    exit_code = 2


class TargetError(ServiceError):
    """A webhook's address is not one that this service speaks to."""


class WorkerRunningError(ServiceError):
    """Another worker has this name."""

    exit_code = 2


@contextmanager
def referred() -> Iterator[None]:
    """Raise UnknownReferenceError for a NotFoundError of the block: the request's body names it, not its path."""
    try:
        yield
    except NotFoundError as error:
        raise UnknownReferenceError(error.found, error.expected, error.do, where=error.where) from error

"""What the service refuses."""

from __future__ import annotations

from collections.abc import Mapping
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
    """What was to be changed is no longer what the client saw."""


class PreconditionRequiredError(ServiceError):
    """A change was asked for without saying what it is a change of."""


class RigMismatchError(ServiceError):
    """A recording or rig file is of other cameras than the rig's."""


class OffsetError(ServiceError):
    """A piece of an upload that does not begin where the last one ended; `headers` have where that is."""

    def __init__(self, found: int, expected: int) -> None:
        super().__init__(f"found the offset {found}, expected {expected}; send the bytes from there on")
        self.headers = {"Upload-Offset": str(expected)}


class UploadSizeError(ServiceError):
    """An upload that is longer than it may be, or than it was said to be."""


class UploadDiskError(ServiceError):
    """The disk has no room for an upload; what came before, `offset` bytes, is kept."""

    def __init__(self, reason: str, offset: int) -> None:
        super().__init__(f"found no room on the disk ({reason}), expected enough for the upload; free some and go on")
        self.headers = {"Upload-Offset": str(offset)}


class DigestError(ServiceError):
    """What was sent is not what was announced."""


class UnauthorizedError(ServiceError):
    """The request carries no token of this service, which needs one."""

    headers = MappingProxyType({"WWW-Authenticate": 'Bearer realm="spike4dgs"'})


class ForbiddenError(ServiceError):
    """The request's token does not allow this."""


class BusyClientError(ServiceError):
    """The client asks too often; it may ask again when `headers` say."""

    def __init__(self, wait_s: int) -> None:
        super().__init__(f"found too many requests of one client, expected fewer; ask again in {wait_s} s")
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
    """The service would be reached from elsewhere by anyone."""

    exit_code = 2


class TargetError(ServiceError):
    """A webhook's address that is not spoken to."""


class WorkerRunningError(ServiceError):
    """Another worker has this name."""

    exit_code = 2

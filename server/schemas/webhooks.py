"""Webhooks: who is told of which events, and how they answered."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from server.schemas.progress import ENDED, Items, Request, Status

Statuses = Annotated[list[Status], Field(min_length=1, max_length=5)]


class WebhookRequest(Request):
    """An address to be told when a capture or job gets one of `statuses`."""

    url: Annotated[str, Field(min_length=8, max_length=2000, pattern=r"^https?://[\x21-\x7e]+$")]
    statuses: Statuses = Field(default=list(ENDED))


class Webhook(BaseModel):
    """An address that is told of captures and jobs."""

    id: str
    created: str
    url: str
    statuses: list[Status]


class NewWebhook(Webhook):
    """A new webhook with the secret that signs its messages, which is shown this once."""

    secret: str


class Webhooks(Items[Webhook]):
    """All webhooks."""


class Happened(BaseModel):
    """The capture or job that a message is about; `seq` is the number of the event, `work` its type."""

    seq: int
    id: str
    name: str | None
    work: str
    status: Status
    error: str | None = None


class WebhookMessage(BaseModel):
    """The body of a message: `type` is `capture.` or `job.` and the status. A test has the type `test`."""

    type: Annotated[str, Field(pattern=r"^((capture|job)\.[a-z]+|test)$")]
    timestamp: str
    data: Happened


class Delivery(BaseModel):
    """An event on its way to a webhook: `said` is the last answer or fault, `due_in_s` when it is tried again."""

    event: int
    status: Literal["waiting", "delivered", "failed"]
    attempts: int
    said: str
    due_in_s: float | None


class Deliveries(Items[Delivery]):
    """Deliveries, newest first."""


class Trial(BaseModel):
    """The result of a test delivery: whether it was accepted, and the answer."""

    ok: bool
    said: str

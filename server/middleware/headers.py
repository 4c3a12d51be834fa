"""Security headers: what a browser may do with an answer."""

from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",  # another site's page cannot show our pictures
}
# For an answer that is no page: a browser shows it and runs nothing.
INERT = "default-src 'none'; img-src 'self'; media-src 'self'; style-src 'unsafe-inline'; frame-ancestors 'self'"
# For a report, a page that this service did not write: it gets an origin of its own and runs nothing.
FOREIGN = (
    "sandbox; default-src 'none'; img-src data:; media-src data:; font-src data:; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
_PLAIN = ("application/json", "application/problem+json", "application/octet-stream", "application/toml")
_PLAIN_KINDS = ("image/", "video/", "audio/", "model/", "text/plain", "text/event-stream", "text/csv")


@dataclass
class SecurityHeaders:
    """Middleware: adds the security headers that a route did not set.

    No answer of the interface can act as a page of the service.
    """

    app: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and add to the answer's headers."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        secret = "authorization" in Headers(scope=scope)

        async def tell(message: Message) -> None:
            if message["type"] == "http.response.start":
                protect(MutableHeaders(scope=message), scope["path"], secret)
            await send(message)

        return await self.app(scope, receive, tell)


def protect(headers: MutableHeaders, path: str, secret: bool) -> None:
    """Set the security headers of the answer to a request for `path`; a `secret` one carried a token."""
    headers.update(ALWAYS)
    if secret:
        headers["Cache-Control"] = "no-store"
    if not path.startswith("/v1"):
        headers.setdefault("Content-Security-Policy", INERT)
        headers["X-Frame-Options"] = "DENY"
        return
    media_type = headers.get("content-type", "application/json").partition(";")[0].strip().lower()
    plain = media_type in _PLAIN or (media_type.startswith(_PLAIN_KINDS) and media_type != "image/svg+xml")
    headers["Content-Security-Policy"] = INERT if plain else FOREIGN
    headers["X-Frame-Options"] = "SAMEORIGIN"
    if "javascript" in media_type or "ecmascript" in media_type:
        headers["Content-Type"] = "text/plain; charset=utf-8"  # so that no page runs it as a script

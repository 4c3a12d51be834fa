"""Work that the web process does beside the requests, again and again, in a thread of its own."""

import logging
import threading
from collections.abc import Callable

from dbos import error as engine_errors
from sqlalchemy.exc import SQLAlchemyError

from server.store.database import reason_of

_LOG = logging.getLogger(__name__)


class Repeated:
    """Calls `work` every `every_s` seconds, and at once where it returns True: more is waiting.

    After an error it tries again, and logs the first of a row.
    """

    def __init__(self, name: str, work: Callable[[], bool], every_s: float) -> None:
        self._work = work
        self._every_s = every_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, when the call under way is over."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        more, well = False, True
        while not self._ended.wait(0 if more else self._every_s):
            try:
                more, well = self._work(), True
            except (engine_errors.DBOSException, SQLAlchemyError, OSError) as error:
                if well:
                    _LOG.warning("the %s tries again after: %s", self._thread.name, reason_of(error))
                more = well = False

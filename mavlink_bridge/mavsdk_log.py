"""Send MAVSDK's log to Python's logging instead of standard output."""

from __future__ import annotations

import atexit
import logging
from functools import cache

from mavsdk import LogLevel, log_subscribe, log_unsubscribe

_LOGGER = logging.getLogger("mavlink_bridge.mavsdk")
_LEVELS = {
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.INFO,
    LogLevel.WARN: logging.WARNING,
    LogLevel.ERROR: logging.ERROR,
}


@cache
def to_python_logging() -> None:
    """Send MAVSDK's log, one for the whole process, to the logger `mavlink_bridge.mavsdk`; the first call counts."""
    log_subscribe(_log)
    atexit.register(log_unsubscribe)


def _log(level: LogLevel, message: str, file: str | None, line: int) -> bool:
    _LOGGER.log(_LEVELS[level], "%s (%s:%s)", message, file, line)
    return True

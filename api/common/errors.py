"""Errors that a client can act on; `api/http/problems.py` turns them into responses.

Nothing is imported here: a worker process needs no web framework for the name of an error.
"""


class ServiceError(Exception):
    """An error that the client can act on."""


class NotFoundError(ServiceError):
    """There is no such resource."""


class ConflictError(ServiceError):
    """The resource is in a state that does not allow this."""


class InvalidError(ServiceError):
    """The request is well-formed but breaks a rule; the message begins with the field."""


class BusyError(ServiceError):
    """The queue is full; try again later."""


class PreconditionError(ServiceError):
    """The resource is not in the version that `If-Match` names."""


class UnauthorizedError(ServiceError):
    """No API key, or one that is not known."""


class ForbiddenError(ServiceError):
    """The API key's role does not allow this."""


class CrossSiteError(ServiceError):
    """A page of another origin made a browser send this."""


class ProxiedError(ServiceError):
    """The request came through a proxy to a service that is open to everybody on this machine."""


class MisdirectedError(ServiceError):
    """The `Host` is not one of this service."""


class MediaTypeError(ServiceError):
    """The body is not JSON."""


class TooManyRequestsError(ServiceError):
    """More requests than a limit allows; it may be tried again after `retry_after_s`."""

    def __init__(self, message: str, retry_after_s: float = 1.0) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class TooLargeError(ServiceError):
    """The body is larger than the service takes."""

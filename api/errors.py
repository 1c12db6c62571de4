"""What goes wrong inside and a client can do something about; `problems` says what it is told.

Nothing is imported here: a worker that solves loads no web framework for the name of an error.
"""


class ServiceError(Exception):
    """An error the client can do something about."""


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


class TooManyRequestsError(ServiceError):
    """More requests than the rate limit allows."""


class TooLargeError(ServiceError):
    """The body is larger than the service takes."""

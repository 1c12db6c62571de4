"""The typed client of the service, used by the command line, the dashboard's tests and scripts."""

from skyfolio.api.client.service_client import ApiError, Client

__all__ = ["ApiError", "Client"]

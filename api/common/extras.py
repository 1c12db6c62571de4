"""Optional dependencies: those that most users do without are extras of the distribution."""

from __future__ import annotations

from importlib.util import find_spec

from skyfolio.api.common.errors import ServiceError

EXTRAS = {"asyncpg": "postgres", "matplotlib": "plots"}
"""The extra that installs each optional module, as `pyproject.toml` names it."""


class MissingExtraError(ServiceError):
    """An optional dependency is needed and not installed."""


def require(module: str, purpose: str) -> None:
    """Check that an optional module is installed. Raises MissingExtraError that names its extra.

    purpose: what needs it, the beginning of the message.
    """
    if find_spec(module) is None:
        raise MissingExtraError(
            f"{purpose} needs {module}, which is not installed: pip install 'skyfolio[{EXTRAS[module]}]'"
        )

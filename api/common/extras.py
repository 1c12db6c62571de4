"""Optional dependencies: those that most users do without are extras of the distribution."""

from __future__ import annotations

from importlib.util import find_spec

from skyfolio.api.common.errors import ServiceError

EXTRAS = {
    "asyncpg": "postgres",
    "matplotlib": "plots",
    "cryptography": "sweep",
    "distributed": "sweep",
    "pandas": "sweep",
    "pyarrow": "sweep",
    "rasterio": "terrain",
}
"""The extra that installs each optional module, as `pyproject.toml` names it."""


class MissingExtraError(ServiceError):
    """An optional dependency is needed and not installed."""


def installed(module: str) -> bool:
    """Return whether an optional module is installed."""
    return find_spec(module) is not None


def require(module: str, purpose: str) -> None:
    """Check that an optional module is installed. Raises MissingExtraError that names its extra.

    purpose: what needs it, the beginning of the message.
    """
    if not installed(module):
        raise MissingExtraError(
            f"{purpose} needs {module}, which is not installed: pip install 'skyfolio[{EXTRAS[module]}]'"
        )


def require_all(extra: str, purpose: str) -> None:
    """Check that every module of an extra is installed. Raises MissingExtraError that names the first missing one."""
    for module, its_extra in EXTRAS.items():
        if its_extra == extra:
            require(module, purpose)

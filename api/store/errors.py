"""The error of the database."""

from __future__ import annotations


class StoreError(Exception):
    """The database could not be read or written; the message holds what it reported."""

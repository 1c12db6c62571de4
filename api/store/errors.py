"""What can go wrong with the database."""

from __future__ import annotations


class StoreError(Exception):
    """The database did not take or give what it should; the message says what it said."""

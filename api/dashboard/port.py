"""What the dashboard shares with `http/`: its path, its cookie, and the mark of its own calls."""

PATH = "/ui"
COOKIE = "skyfolio_key"
"""Carries the operator's API key: browsers cannot send headers with a page or an event stream."""
INSIDE = "skyfolio.inside"
"""Key in the ASGI scope of calls that the dashboard makes in process for a client that may open the page."""

"""What the dashboard and the service's HTTP side agree on: where it lives, and how its own calls are known."""

PATH = "/ui"
COOKIE = "skyfolio_key"
"""Carries the API key of whoever looks: browsers cannot send headers with a page or an event stream."""
INSIDE = "skyfolio.inside"
"""Key of the ASGI scope of calls that the dashboard makes in process, for somebody who was let in to the page."""

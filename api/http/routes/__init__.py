"""HTTP routes. Each parses, calls one part of the service, and renders; nothing is decided here."""

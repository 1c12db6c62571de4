"""HTTP routes. Each parses a request, calls one part of the service, and renders the result; routes decide nothing."""

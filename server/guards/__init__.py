"""The guards: what a request passes before it comes to a route, each an ASGI middleware that does one thing."""

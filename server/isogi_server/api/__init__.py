"""The HTTP API: the service, its routes, its stream, and the middleware before them."""

"""The service suite: one server under drags, crowds and malformed files, as its clients see it."""

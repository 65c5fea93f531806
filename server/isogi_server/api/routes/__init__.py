"""The routes, one noun per file; each is thin and leaves the work to the service."""

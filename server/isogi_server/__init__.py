"""HTTP and the command line around the renderer."""

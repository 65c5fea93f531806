"""The speed suite: frames, rays, paths and bakes, beside peers where they are installed."""

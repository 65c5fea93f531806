"""Frames: camera → G-buffer → texels → light → tone curve."""

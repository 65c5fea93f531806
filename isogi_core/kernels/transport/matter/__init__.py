"""Light that passes through the matter behind an isosurface:
refracted, absorbed and scattered there.
"""

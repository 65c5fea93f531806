"""Light that passes through what an isosurface bounds: refracted, absorbed and scattered there."""

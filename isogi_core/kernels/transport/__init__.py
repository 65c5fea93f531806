"""Transport: paths of light over an isosurface, their random numbers,
and the light that texels store.
"""

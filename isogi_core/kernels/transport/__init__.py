"""Transport: paths of light over an isosurface, their random numbers, and what texels keep of
them.
"""

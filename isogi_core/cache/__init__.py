"""The illumination cache: layers of chunks in a Zarr store, and the page pool of decoded chunks in
memory.
"""

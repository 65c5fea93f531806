"""The illumination cache: chunks of baked light in a Zarr store, and the pool of those in memory."""

"""The cache of baked light: layers of chunks in a store,
and the page pool of decoded chunks in memory.
"""

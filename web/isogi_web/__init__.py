"""The page: HTML, styles, modules and shaders that ``isogi serve`` answers with and
``isogi publish`` writes.
"""

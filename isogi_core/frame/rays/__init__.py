"""Light of single pixels by rays and paths: lobes, shine, walls, glass, and control pixels,
which measure the error of a picture.
"""

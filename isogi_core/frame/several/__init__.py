"""Several surfaces in one picture: depth peels of their layers, the light of each side, and the
sum of all.
"""

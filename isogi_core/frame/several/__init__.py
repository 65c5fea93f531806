"""Several surfaces in one picture: what rays meet, layer behind layer, the light of each side, and
their sum.
"""

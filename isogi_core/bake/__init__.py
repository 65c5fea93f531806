"""Baking: the layers of light that a texel keeps, sample by sample, with the estimated error of
each.
"""

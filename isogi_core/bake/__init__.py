"""Baking: radiance transfer of texels, sample by sample, with the error it still has."""

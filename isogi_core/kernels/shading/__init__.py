"""Shading: from the light of texels to pixels: lattice, chunks, interpolation,
local models, framebuffer.
"""

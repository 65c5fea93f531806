"""Data for a visitor's graphics card: the light of whole chunks in blocks, and reasons why a
card cannot draw a view.
"""

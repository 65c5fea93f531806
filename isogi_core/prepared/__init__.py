"""Prepared scenes: what rays meet. The field, its active-cell maps and its lattice, worked out
once.
"""

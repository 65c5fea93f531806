"""Prepared scenes: the field, active-cell maps and lattice that rays meet, computed once."""

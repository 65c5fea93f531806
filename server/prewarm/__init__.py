"""Prewarming: light of many views, or of whole isosurfaces, baked ahead; from the command line and
over HTTP.
"""

"""Prewarming: baking the light of many views, or of whole isosurfaces,
before somebody looks; for the command line and over HTTP.
"""

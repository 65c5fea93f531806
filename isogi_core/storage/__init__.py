"""Stores of objects by key, in folders and object stores; each object is written whole or not at
all.
"""

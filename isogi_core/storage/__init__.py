"""Stores of objects by key, in folders and in object stores.

Each object is written whole or not at all.
"""

"""Upkeep of a store: audit and repair, census, and pruning of unused layers."""

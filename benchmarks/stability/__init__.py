"""Stability: what stiff and extreme cases are expected to do, and what they do: ``python -m benchmarks.stability``."""

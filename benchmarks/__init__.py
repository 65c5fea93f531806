"""Measurements in four suites: ``python -m benchmarks.speed``, ``accuracy``, ``service`` and
``scaling``.
"""

"""Rendering for many clients: the engine, its workers, and the order in which clients are
served.
"""

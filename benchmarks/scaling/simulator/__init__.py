"""A simulated cluster: the real queue and the real baker over workers, a store and viewers that
only pretend.
"""

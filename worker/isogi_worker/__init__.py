"""Baking in worker processes: requests for light, the queue that orders them,
the tasks that bake, and pools of processes that run tasks.
"""

"""Bake requests, the queue that orders them, the tasks that bake them, and the processes that run
tasks.
"""

"""Light that a view has of its own, by rays: lobes, shine, walls, and the control pixels that
measure its error.
"""

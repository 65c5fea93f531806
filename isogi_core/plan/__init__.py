"""Scene assembly and the planner: what each texel must keep, what is left out, why, and what that
saves.
"""

"""Scene assembly and the planner: the numbers that each texel must keep, and the things that
are left out, with reasons and savings.
"""

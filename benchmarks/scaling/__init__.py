"""The scaling suite: many workers, large volumes, kills and damage, and what is foretold of long
bakes.
"""

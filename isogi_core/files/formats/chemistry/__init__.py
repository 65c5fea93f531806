"""Grids of chemistry and crystals, as programs write them in text: Gaussian cube, VASP, OpenDX, and
XCrySDen's files.
"""

"""What a visitor's graphics card draws from: light of whole chunks, packed, and the facts of a
scene beside it.
"""

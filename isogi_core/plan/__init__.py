"""Planning: the least that a scene must keep for its picture, and what that leaves out."""

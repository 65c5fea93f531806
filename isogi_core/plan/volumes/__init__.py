"""What volumes a scene is of: opened from files, masked, cut open, labelled, and coloured by
data.
"""

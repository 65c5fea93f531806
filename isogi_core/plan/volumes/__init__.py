"""The volumes of a scene: opened from files, masked, cut, labelled, and coloured by data."""

"""Light that leaves isogi: isosurfaces and volumes of a scene in files of other tools."""

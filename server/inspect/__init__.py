"""``isogi inspect``: what isogi knows about a volume or a scene, and how stiff the volume is."""

"""``isogi inspect``: facts about a volume or a scene, and the stiffness of the volume."""

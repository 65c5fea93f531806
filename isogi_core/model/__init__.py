"""What is rendered: volume, lights, scene, view and plan, as plain immutable data."""

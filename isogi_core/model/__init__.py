"""Volume, lights, view and plan as plain immutable data, in the user's units."""

"""Plans: what each texel of a scene must keep, what may be left out, why, and what that saves."""

"""Side-by-side runs that print ratios from one run. Absolute times mean little on a shared machine."""

"""What a light needs: its harmonics, and how many of them a surface shows."""

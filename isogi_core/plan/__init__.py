"""What a scene needs: how a light is projected, how many harmonics it asks for, and what keeps it from ringing."""

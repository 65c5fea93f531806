"""The accuracy suite: how wrong pictures are, by cause, and what that costs."""

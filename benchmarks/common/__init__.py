"""What the four suites share."""

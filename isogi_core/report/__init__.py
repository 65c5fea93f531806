"""The report: what isogi's light costs and how wrong it is, measured against references, and split by cause."""

"""How scores stand in a table."""

from isogi_core.report.metrics import Score
from isogi_core.report.sections import Cell, Column

COLUMNS = (
    Column("relative RMSE", "share"),
    Column("99th percentile", "share"),
    Column("bias", "share"),
    Column("FLIP", "number"),
)
"""The columns of a score."""


def cells(score: Score) -> tuple[Cell, ...]:
    """The cells of a score under COLUMNS."""
    return score.rmse, score.p99, score.bias, score.flip

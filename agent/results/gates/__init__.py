"""Gates: limits that an estimate and its compensation table must meet before the table is written."""

"""Compensation tables, their export to the formats of controllers, and the correction of part programs with a table."""

"""Compensation tables, their export to the formats of controllers, and correction of part programs."""

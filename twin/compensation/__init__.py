"""Compensation tables, the formats of controllers, and corrected part programs."""

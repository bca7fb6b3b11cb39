"""Compensation tables as drivers store them: limit checks, text format, durable files."""

"""Correction of part programs in G-code (ISO 6983, RS-274/NGC) with a compensation table.

This is for controllers without compensation tables. The input is lines of text, and so is the output; only the moves
are changed.
"""

"""Correction of part programs in G-code (ISO 6983, RS-274/NGC) with a compensation table.

It is intended for controllers that cannot use a compensation table. The input and the output are lines of text. Only
moves are changed. Terms are defined in docs/reference/glossary.md.
"""

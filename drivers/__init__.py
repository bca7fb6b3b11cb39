"""Roles of devices, links over which devices are reached, and the drivers that are part of volcal.

Terms are defined in docs/reference/glossary.md.
"""

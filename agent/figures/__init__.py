"""Common style of all figures: the colours, fonts and axes of the figures in reports and studies."""

FIGURE_ENDINGS = (".png", ".svg", ".pdf")
"""Endings of the names of files with a figure, each with its format (`agent.figures.style.Picture.in_format_of`)."""

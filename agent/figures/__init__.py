"""Common style of all figures: the colours, fonts and axes of the figures in reports and studies."""

"""House style of figures: colours, fonts and axes of reports and studies."""

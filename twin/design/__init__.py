"""Design of positions: which ones to measure so that the compensated machine becomes as good as it can in the time."""

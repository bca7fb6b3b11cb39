"""Long trials of the whole agent on simulated machines; each ends with one line of JSON."""

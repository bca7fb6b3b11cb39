"""`volcal design`: from a job to a position file, with its machine minutes and its value."""

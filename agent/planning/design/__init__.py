"""`volcal design`: from a job to a position file, with its price in machine minutes and what it is worth."""

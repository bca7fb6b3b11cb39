"""Design of a position set for a job, with its machine minutes and its valuation (`volcal design`)."""

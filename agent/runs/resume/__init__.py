"""Resume or abandon an interrupted run."""

"""Going on with a run that broke off, and knowing at a start what the one before has left behind."""

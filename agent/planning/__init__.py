"""Everything that is decided before anything moves: job, measuring order, cycle time, preflight."""

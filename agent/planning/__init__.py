"""Planning of a run before anything moves: job, measuring order, cycle time and preflight."""

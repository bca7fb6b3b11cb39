"""Expected error after compensation: an error budget in closed form, distributions, Monte Carlo, and coverage."""

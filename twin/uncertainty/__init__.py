"""Expected error after compensation: error budget in closed form, distributions, Monte Carlo, coverage."""

"""The person at the machine, reached through the terminal that volcal runs in."""

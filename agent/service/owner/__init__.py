"""The owner of the machine: accepts requests from every endpoint and carries out one run at a time."""

"""The owner of the machine, which accepts requests from every endpoint and carries out one run at a time."""

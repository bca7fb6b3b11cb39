"""Owner of the machine. It accepts requests from every endpoint and carries out one run at a time."""

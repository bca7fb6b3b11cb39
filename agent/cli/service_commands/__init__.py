"""Commands that send a request to the running service; none of them loads mathematics or drivers."""

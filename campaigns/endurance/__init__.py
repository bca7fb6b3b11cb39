"""Many runs in one service: memory, handles, threads and disk space per run."""

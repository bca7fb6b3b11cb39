"""Benchmarks. Their results are ratios of times measured side by side in one run; no test asserts them."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does; see agent/cli/main.py

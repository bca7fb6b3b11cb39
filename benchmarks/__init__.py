"""Benchmarks: figures as ratios measured side by side in one run; never asserted in tests."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does; see agent/cli/main.py

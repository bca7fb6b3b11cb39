"""Benchmarks of the library, the agent and the service.

The results are ratios of times that are measured side by side in one run. No test checks them.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does; see agent/cli/main.py

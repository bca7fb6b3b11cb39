"""Exclude the example's tests, which tests/contract/test_third_party_plugin.py runs with the installed example."""

collect_ignore = ["tests"]

"""The example's tests need the example installed: tests/contract/test_third_party_plugin.py does both."""

collect_ignore = ["tests"]

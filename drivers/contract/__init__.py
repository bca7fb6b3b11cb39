"""Contract tests, which every driver of a device role must pass. The tests of each driver subclass them.

The package needs pytest. See docs/how-to/write-a-driver-plugin.md.
"""

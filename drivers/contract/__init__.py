"""Contract tests of the device roles. The tests of each driver subclass them.

The package needs pytest. See docs/how-to/write-a-driver-plugin.md.
"""

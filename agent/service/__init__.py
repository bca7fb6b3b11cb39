"""The night service: one owner of the machine, and the doors through which people and machines ask it for something."""

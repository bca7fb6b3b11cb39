"""Proposals for the set-up of a machine that volcal does not know yet: error family, artefact, stations, position set.

All functions are pure. Their input is what a person or the controller states about the machine.
"""

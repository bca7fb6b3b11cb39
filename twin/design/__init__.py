"""Optimal design of a measurement: choice of the artefact positions to be measured, so that the expected error after
compensation is smallest within the available machine time."""

"""Texts of the files that describe a new machine: machine, artefact, settings and simulator scenario, with comments."""

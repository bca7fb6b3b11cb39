"""Temperature models: what the temperatures of a run change in a machine, and what is assumed of the artefact's
temperature.

A temperature model is a module of this package and an entry of the table in `twin.thermal.models`. It turns the
temperatures of the machine during a run into a few regressors, and it says which errors change in proportion to each of
them. The identification, the gates and the proof of a table work with any model.
"""

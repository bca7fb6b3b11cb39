"""Temperatures in a run: readings, limits, the wait until the artefact has settled, the drift of the machine, and the
statement on the artefact's thermometer in reports. The models of the drift are in `twin.thermal`."""

"""Ball artefact: calibrated ball centres, positions on the machine, touch patterns, sphere fit and measured centres."""

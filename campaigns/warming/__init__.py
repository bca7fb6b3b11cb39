"""Trial with calibrations during which the machine and the ball bar (the artefact) warm up."""

"""Digital calibration certificate (DCC) of a ball artefact: XML in the schema of PTB with quantities in D-SI."""

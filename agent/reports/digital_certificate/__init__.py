"""Report of a calibration as a digital calibration certificate (DCC, schema 3.3.0 of PTB, with quantities in D-SI)."""

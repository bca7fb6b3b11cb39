"""Ball artefact: its calibrated ball centres, its positions on the machine, the touches of its balls, and the fitted
ball centres.
"""

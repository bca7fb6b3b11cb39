"""Calibration service. It consists of the single owner of the machine and of the endpoints for people, panels and other
programs.
"""

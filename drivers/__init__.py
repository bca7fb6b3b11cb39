"""Roles that devices play, the links they are reached by, and the drivers that ship with volcal."""

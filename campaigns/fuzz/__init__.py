"""Mutations of good files, frames and lines, given to every decoder: nothing outside the error tree, and no hang."""

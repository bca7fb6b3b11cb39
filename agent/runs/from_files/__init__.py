"""Identification without a machine: from files with ball centres to files with an estimate, a table and a report."""

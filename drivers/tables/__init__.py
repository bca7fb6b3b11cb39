"""Compensation tables as drivers keep them: what a store can take, their text form, banks of files."""

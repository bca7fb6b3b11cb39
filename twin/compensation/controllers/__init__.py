"""Compensation tables in the formats of real controllers: the text, and the parts of a table that a format loses.

One module per format. Each knows how its controller reads its file, so signs, references and limits are defined there
and nowhere else. Nothing here reads or writes files.
"""

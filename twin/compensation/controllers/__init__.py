"""Export of compensation tables to the formats of real controllers.

One module per format. Each defines how its controller reads its file, so signs, references and limits are defined there
and nowhere else. An export also reports the features of a table that the format cannot represent. Nothing here reads or
writes files.
"""

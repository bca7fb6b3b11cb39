"""Export of compensation tables to the formats of real controllers.

There is one module per format. It defines how the controller reads its file. Signs, reference points and limits of the
format are therefore defined in this module and nowhere else. An export also reports the features of a table that the
format cannot represent. The modules return the text of files, but do not read or write files.
"""

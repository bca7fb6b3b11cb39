"""Transfer of parameters and tables over RS-232 in the tape format of FANUC controllers.

After writing, the data are read back and compared.
"""

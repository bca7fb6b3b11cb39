"""Transfer of parameters and tables in tape format over RS-232. Data written is read back and compared."""

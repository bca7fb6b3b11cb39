"""Transfer of parameters and tables in tape format over RS-232, with a comparison after writing."""

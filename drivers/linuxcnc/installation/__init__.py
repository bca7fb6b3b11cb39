"""Installation of volcal into the configuration of a LinuxCNC machine, and its removal."""

INSTALL_HELP = "Add what volcal needs to the configuration of a LinuxCNC machine, or take it out."
"""Help line of `volcal linuxcnc`. It is defined here because the list of commands imports only this package."""

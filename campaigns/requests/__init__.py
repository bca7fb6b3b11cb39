"""Random requests to the owner of the machine at all moments of real runs in virtual time, with a link that fails."""

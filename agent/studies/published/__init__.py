"""Claims of the publication about the procedure, each checked on several machines, in two readings of the method and in
every measure of the volumetric error."""

"""Digital certificates: their signatures, and the one of an artefact as its artefact file."""

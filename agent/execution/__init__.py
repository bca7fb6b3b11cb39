"""Steps of a plan, the engine that carries them out, the journal that records them, and the states of a run."""

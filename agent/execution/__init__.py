"""Steps, the engine that has them done, the journal that remembers them, the states a run is in."""

"""The page at the machine: what is shown and asked there. All it needs is served from here; no network beyond."""

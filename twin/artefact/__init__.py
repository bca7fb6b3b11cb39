"""The ball artefact: certificate, position sets, touches, sphere fit and observations."""

"""Release files of volcal: the wheel, the Debian package, the bill of materials, their sums and the signature; and the
audit of what they are made from. The same commit gives the same bytes."""
